// Gaussian kernels, as real numbers and as whole ones.
#pragma once

#include <array>
#include <cstdint>

namespace foreglow {

// One side of a symmetric kernel of at most five taps: [k] weighs the pixels k away. All five sum to one.
using HalfKernel = std::array<double, 3>;

HalfKernel gaussian_taps(std::int32_t size, double sigma_px);

// Whole-number taps in the proportions of a real kernel.
struct WholeTaps {
    std::array<std::int16_t, 3> taps{};
    std::int32_t sum = 0;          // of all five
    double error = 0.0;  // departures of all taps / sum from the real kernel: a blur of at most 1 is off by no more
};

// The most exact taps whose sum times `largest_value` stays below 2^31. Among the many scales some come very near to
// whole numbers in all taps at once, so that 16 bits are as good as single precision.
WholeTaps whole_taps(const HalfKernel& kernel, std::int64_t largest_value);

// Index of a row or column outside an image of `length`, mirrored about the border pixel (... 2 1 | 0 1 2 ...).
inline std::int64_t mirrored(std::int64_t index, std::int64_t length) {
    if (length == 1) return 0;
    while (index < 0 || index >= length) index = index < 0 ? -index : 2 * (length - 1) - index;
    return index;
}

}  // namespace foreglow
