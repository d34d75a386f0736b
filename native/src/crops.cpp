#include "foreglow/crops.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

namespace foreglow {
namespace {

// Bilinear weights of one axis: output i reads inputs `near[i]` and `far[i]`, in fixed point of 11 bits.
struct Axis {
    std::vector<std::int32_t> near, far, near_weight, far_weight;

    Axis(std::int32_t length, std::int32_t size_px)
        : near(size_px), far(size_px), near_weight(size_px), far_weight(size_px) {
        const double scale = static_cast<double>(length) / size_px;
        for (std::int32_t i = 0; i < size_px; ++i) {
            const float position = static_cast<float>((i + 0.5) * scale - 0.5);
            std::int32_t index = static_cast<std::int32_t>(std::floor(position));
            float fraction = position - static_cast<float>(index);
            if (index < 0) { index = 0; fraction = 0.0F; }
            if (index >= length - 1) { index = length - 1; fraction = 0.0F; }
            near[i] = index;
            far[i] = std::min(index + 1, length - 1);
            far_weight[i] = static_cast<std::int32_t>(std::lrint(fraction * 2048.0F));
            near_weight[i] = static_cast<std::int32_t>(std::lrint((1.0F - fraction) * 2048.0F));
        }
    }
};

template <typename Pixel>
void extract_crop(const ImageView& image, std::int32_t left, std::int32_t top, std::int32_t right, std::int32_t bottom,
                  std::int32_t size_px, float* crop) {
    const Axis across(right - left, size_px), down(bottom - top, size_px);
    const std::size_t num_pixels = static_cast<std::size_t>(size_px) * static_cast<std::size_t>(size_px);
    float lowest = INFINITY, highest = -INFINITY;
    for (std::int32_t i = 0; i < size_px; ++i) {
        const Pixel* upper = image.row<Pixel>(top + down.near[i]) + left;
        const Pixel* lower = image.row<Pixel>(top + down.far[i]) + left;
        const std::int64_t upper_weight = down.near_weight[i], lower_weight = down.far_weight[i];
        for (std::int32_t j = 0; j < size_px; ++j) {
            const std::int64_t above = std::int64_t{upper[across.near[j]]} * across.near_weight[j] +
                                       std::int64_t{upper[across.far[j]]} * across.far_weight[j];
            const std::int64_t below = std::int64_t{lower[across.near[j]]} * across.near_weight[j] +
                                       std::int64_t{lower[across.far[j]]} * across.far_weight[j];
            const std::int64_t level = (above * upper_weight + below * lower_weight + (1 << 21)) >> 22;
            const float value = static_cast<float>(level);
            lowest = std::min(lowest, value);
            highest = std::max(highest, value);
            crop[i * size_px + j] = value;
        }
    }
    const float range = highest - lowest;
    for (std::size_t i = 0; i < num_pixels; ++i) crop[i] = range > 0.0F ? (crop[i] - lowest) / range : 0.0F;
}

}  // namespace

void extract_crops(const ImageView& image, const Box* boxes, std::size_t num_boxes, std::int32_t support,
                   std::int32_t size_px, float* crops) {
    const std::size_t num_pixels = static_cast<std::size_t>(size_px) * static_cast<std::size_t>(size_px);
    for (std::size_t i = 0; i < num_boxes; ++i) {
        const Box& box = boxes[i];
        const std::int64_t width = std::int64_t{box.x2} - box.x1, height = std::int64_t{box.y2} - box.y1;
        const std::int64_t x = box.x1 + width / 2, y = box.y1 + height / 2;
        const auto clip = [](std::int64_t value, std::int32_t limit) {
            return static_cast<std::int32_t>(std::clamp<std::int64_t>(value, 0, limit));
        };
        const std::int32_t left = clip(x - support * width, image.width_px);
        const std::int32_t right = clip(x + support * width, image.width_px);
        const std::int32_t top = clip(y - support * height, image.height_px);
        const std::int32_t bottom = clip(y + support * height, image.height_px);
        float* crop = crops + i * num_pixels;
        if (left >= right || top >= bottom) {
            std::fill(crop, crop + num_pixels, 0.0F);
        } else if (image.pixel_type == PixelType::u8) {
            extract_crop<std::uint8_t>(image, left, top, right, bottom, size_px, crop);
        } else {
            extract_crop<std::uint16_t>(image, left, top, right, bottom, size_px, crop);
        }
    }
}

}  // namespace foreglow
