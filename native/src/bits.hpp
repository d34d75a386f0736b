// Rows of bits whose even and odd columns lie in words of their own.
#pragma once

#include <cstdint>

namespace foreglow {

// Bit i of the lower half goes to bit 2 i.
inline std::uint64_t spread(std::uint64_t bits) {
    bits &= 0xFFFFFFFFULL;
    bits = (bits | bits << 16) & 0x0000FFFF0000FFFFULL;
    bits = (bits | bits << 8) & 0x00FF00FF00FF00FFULL;
    bits = (bits | bits << 4) & 0x0F0F0F0F0F0F0F0FULL;
    bits = (bits | bits << 2) & 0x3333333333333333ULL;
    return (bits | bits << 1) & 0x5555555555555555ULL;
}

// 64 columns in their order, from 32 even and 32 odd ones.
inline std::uint64_t interleaved(std::uint64_t even, std::uint64_t odd) { return spread(even) | spread(odd) << 1; }

}  // namespace foreglow
