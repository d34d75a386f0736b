// Two lights beside each other, alike in size and brightness, may be the two headlamps of one vehicle.
#pragma once

#include <cstddef>

namespace foreglow {

// Writes how far each of `num` boxes is from its partner, radians, to `spacings_rad`; NaN without one.
//
// Partners are at like height, of like size and brightness, and each is the other's best: the nearer, the better.
// `centres_rad` has two numbers a box (to the left, upwards), `sizes_rad` two (width, height), `contrasts` one: the
// brightness over the surroundings, in any unit, positive.
void pair_spacings(const double* centres_rad, const double* sizes_rad, const double* contrasts, std::size_t num,
                   double* spacings_rad);

}  // namespace foreglow
