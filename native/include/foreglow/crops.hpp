// Crops of proposals as the classifier reads them.
#pragma once

#include "foreglow/image.hpp"

namespace foreglow {

// What is cut out of the frame for each box.
struct CropSpec {
    std::int32_t support = 2;  // the region reaches this many widths and heights of the box from its centre
    std::int32_t size_px = 64;
};

// Writes `num_boxes` crops of `size_px` x `size_px` floats in [0, 1] to `crops`, one after another.
//
// The region of a box of w x h around (cx, cy) = (x1 + w / 2, y1 + h / 2), integer division, spans
// cx - support * w .. cx + support * w and cy - support * h .. cy + support * h, cut at the image's border. It is
// resized bilinearly (half-pixel centres, no smoothing, rounded to whole grey levels) and stretched to [0, 1] by its
// own minimum and maximum; a flat crop is all zero. The grey levels are those of OpenCV's INTER_LINEAR: equal for 8 bit,
// within one of 65,535 for 16 bit.
//
// With `earlier`, an image of the same size and type, each crop is followed by the same region of that image, stretched
// as the crop was and cut at 0 and 1.
//
// `levels` takes two floats a box: the crop's minimum and maximum before stretching, as shares of full scale.
//
// A region that has no pixel inside the image gives crops and levels of zero.
void extract_crops(const ImageView& image, const ImageView* earlier, const Box* boxes, std::size_t num_boxes,
                   const CropSpec& spec, float* crops, float* levels);

}  // namespace foreglow
