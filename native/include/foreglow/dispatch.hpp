// Instruction sets: the same boxes at each of them, and the same ranges but for their last digits, at another speed.
#pragma once

#include <cstdint>
#include <vector>

namespace foreglow {

// Weakest first. `baseline` is what every processor of the architecture has.
enum class Dispatch : std::uint8_t { baseline, avx2, avx512 };

std::vector<Dispatch> available_dispatch();
const char* name_of(Dispatch dispatch);

}  // namespace foreglow
