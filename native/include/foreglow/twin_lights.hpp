// Two lights of one box, such as the headlamps of a distant vehicle, which are too near to each other for two boxes.
#pragma once

#include <cstddef>

#include "foreglow/image.hpp"

namespace foreglow {

// Writes two numbers a box to `columns_px`: the columns of the left and of the right light of its pair, pixels of the
// image; NaN where there aren't exactly two lights side by side, alike in brightness, width and height, with a darker
// place in between.
// Boxes that are narrower than 5 pixels, or larger than 256 in width or height, have none.
void twin_lights(const ImageView& image, const Box* boxes, std::size_t num_boxes, double* columns_px);

}  // namespace foreglow
