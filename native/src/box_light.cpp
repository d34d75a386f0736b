#include "foreglow/box_light.hpp"

#include <algorithm>
#include <limits>

namespace foreglow {
namespace {

constexpr int num_samples = 9;
// Where the surroundings are read, in widths and heights of the box from its corner.
constexpr double rim[][2] = {{-0.5, -0.5}, {0.0, -0.5}, {0.5, -0.5}, {1.0, -0.5}, {1.5, -0.5}, {-0.5, 1.5},
                             {0.0, 1.5},   {0.5, 1.5},  {1.0, 1.5},  {1.5, 1.5},  {-0.5, 0.0}, {-0.5, 0.5},
                             {-0.5, 1.0},  {1.5, 0.0},  {1.5, 0.5},  {1.5, 1.0}};
constexpr int num_rim = sizeof rim / sizeof rim[0];

std::int32_t index_of(double place_px, std::int32_t size_px) {
    return static_cast<std::int32_t>(std::min(std::max(place_px, 0.0), size_px - 0.5));
}

template <typename Pixel>
void light_of(const ImageView& image, const Box& box, double* pixel, double* peak) {
    const double width = static_cast<double>(box.x2) - box.x1, height = static_cast<double>(box.y2) - box.y1;
    Pixel around[num_rim];
    for (int i = 0; i < num_rim; ++i) {
        around[i] = image.row<Pixel>(index_of(box.y1 + height * rim[i][1], image.height_px))
                        [index_of(box.x1 + width * rim[i][0], image.width_px)];
    }
    double x[num_samples], y[num_samples];
    std::int32_t columns[num_samples];
    for (int i = 0; i < num_samples; ++i) {
        x[i] = box.x1 + width * ((i + 0.5) / num_samples);
        columns[i] = index_of(x[i], image.width_px);
    }
    // All is read before anything is done with it, so that one place does not wait for the memory of another.
    Pixel inside[num_samples][num_samples];
    for (int j = 0; j < num_samples; ++j) {
        y[j] = box.y1 + height * ((j + 0.5) / num_samples);
        const Pixel* row = image.row<Pixel>(index_of(y[j], image.height_px));
        for (int i = 0; i < num_samples; ++i) inside[j][i] = row[columns[i]];
    }
    // Other lights may be beside the box: half of the rim is dark.
    std::nth_element(around, around + num_rim / 2, around + num_rim);
    const double surroundings = around[num_rim / 2];
    double total = 0.0, sum_x = 0.0, sum_y = 0.0, most = 0.0;
    for (int j = 0; j < num_samples; ++j) {
        double row_total = 0.0;
        for (int i = 0; i < num_samples; ++i) {
            const double above = std::max(inside[j][i] - surroundings, 0.0);
            const double weight = above * above + 1e-9;
            most = std::max(most, above);
            row_total += weight;
            sum_x += weight * x[i];
        }
        total += row_total;
        sum_y += row_total * y[j];
    }
    pixel[0] = sum_x / total;
    pixel[1] = sum_y / total;
    *peak = most / std::numeric_limits<Pixel>::max();
}

}  // namespace

void light_of_boxes(const ImageView& image, const Box* boxes, std::size_t num_boxes, double* pixels, double* peaks) {
    for (std::size_t i = 0; i < num_boxes; ++i) {
        if (image.pixel_type == PixelType::u8) {
            light_of<std::uint8_t>(image, boxes[i], pixels + 2 * i, peaks + i);
        } else {
            light_of<std::uint16_t>(image, boxes[i], pixels + 2 * i, peaks + i);
        }
    }
}

}  // namespace foreglow
