// What the pixels of a box say about its light. The specification is foreglow.distance.box_light (Python).
#pragma once

#include "foreglow/image.hpp"

namespace foreglow {

// Writes two numbers a box to `pixels`: where its light is (x, y), the mean of the box weighted with the square of what
// each pixel has above the surroundings; the centre of a box without light. And one to `peaks`: the brightest pixel over
// the surroundings, as a share of full scale.
//
// The box is read on a grid of 9 x 9 places, its surroundings at 16 places half a width and height around it, whose
// ninth-darkest stands for all. Places outside the image take its nearest pixel; the image has at least one.
void light_of_boxes(const ImageView& image, const Box* boxes, std::size_t num_boxes, double* pixels, double* peaks);

}  // namespace foreglow
