#include "foreglow/twin_lights.hpp"

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <limits>

namespace foreglow {
namespace {

constexpr std::int32_t min_width_px = 5, max_size_px = 256;
// Shares of the brighter light: how bright the other one is at least, and of the darker one: how deep the place between
// them is at least; over the darkest column of the box.
constexpr double min_share = 0.6, min_depth = 0.2;
// What the brighter light has over that column at least, of full scale.
constexpr double min_contrast = 12.0 / 255.0;
// Of the wider to the narrower light, and how much higher one of them begins at most, of their spacing.
constexpr double max_width_ratio = 2.2, max_rise = 0.25;

struct Columns {
    std::int32_t num = 0;
    std::array<double, max_size_px> greys{};
};

// The brightest pixel of each column, smoothed over three columns, so that single bright pixels are no lights.
template <typename Pixel>
void read(const ImageView& image, const Box& box, Columns& columns) {
    std::array<Pixel, max_size_px> brightest{};
    columns.num = box.x2 - box.x1;
    for (std::int32_t y = box.y1; y < box.y2; ++y) {
        const Pixel* row = image.row<Pixel>(y) + box.x1;
        for (std::int32_t i = 0; i < columns.num; ++i) brightest[i] = std::max(brightest[i], row[i]);
    }
    for (std::int32_t i = 0; i < columns.num; ++i) {
        const double before = brightest[std::max(i - 1, 0)], after = brightest[std::min(i + 1, columns.num - 1)];
        columns.greys[i] = 0.25 * before + 0.5 * brightest[i] + 0.25 * after;
    }
}

struct Light {
    std::int32_t first = 0, end = 0;
    double column = 0.0;
};

// The light at and after `first`, which is brighter than `level`: the mean column, weighted with what is above.
Light light_from(const Columns& columns, std::int32_t first, double level) {
    Light light{first, first, 0.0};
    double total = 0.0;
    for (; light.end < columns.num && columns.greys[light.end] > level; ++light.end) {
        const double above = columns.greys[light.end] - level;
        total += above;
        light.column += above * light.end;
    }
    light.column /= total;
    return light;
}

std::int32_t next_above(const Columns& columns, std::int32_t from, double level) {
    while (from < columns.num && columns.greys[from] <= level) ++from;
    return from;
}

// The level halfway between the darker light and the darkest place between the two; infinity without two lights.
double level_between(const Columns& columns, double full_scale) {
    const auto begin = columns.greys.begin(), end = begin + columns.num;
    const auto brightest = static_cast<std::int32_t>(std::max_element(begin, end) - begin);
    const double dark = *std::min_element(begin, end), most = columns.greys[brightest] - dark;
    double level = std::numeric_limits<double>::infinity();
    if (most < min_contrast * full_scale) return level;
    double deepest = 0.0;
    for (const std::int32_t step : {-1, 1}) {
        double between = columns.greys[brightest];
        for (std::int32_t i = brightest; i >= 0 && i < columns.num; i += step) {
            const double grey = columns.greys[i], above = grey - dark;
            between = std::min(between, grey);
            const double depth = grey - between;
            if (above >= min_share * most && depth >= min_depth * above && depth > deepest) {
                deepest = depth;
                level = 0.5 * (grey + between);
            }
        }
    }
    return level;
}

// The first row in which a light is brighter than `level`.
template <typename Pixel>
std::int32_t top_of(const ImageView& image, const Box& box, const Light& light, double level) {
    std::int32_t y = box.y1;
    const auto is_brighter = [level](Pixel grey) { return grey > level; };
    for (; y < box.y2; ++y) {
        const Pixel* row = image.row<Pixel>(y) + box.x1;
        if (std::any_of(row + light.first, row + light.end, is_brighter)) break;
    }
    return y;
}

bool are_alike(const Light& left, const Light& right, std::int32_t rise) {
    const auto [narrower, wider] = std::minmax({left.end - left.first, right.end - right.first});
    return wider <= max_width_ratio * narrower && std::abs(rise) <= std::max(1.0, max_rise * (right.column - left.column));
}

template <typename Pixel>
void twins_of(const ImageView& image, const Box& its, double* columns_px) {
    columns_px[0] = columns_px[1] = std::numeric_limits<double>::quiet_NaN();
    const Box box{std::max(its.x1, 0), std::max(its.y1, 0), std::min(its.x2, image.width_px),
                  std::min(its.y2, image.height_px)};
    const std::int64_t width = std::int64_t{box.x2} - box.x1, height = std::int64_t{box.y2} - box.y1;
    if (width < min_width_px || width > max_size_px || height < 1 || height > max_size_px) return;
    Columns columns;
    read<Pixel>(image, box, columns);
    const double level = level_between(columns, std::numeric_limits<Pixel>::max());
    const std::int32_t first = next_above(columns, 0, level);
    if (first == columns.num) return;
    const Light left = light_from(columns, first, level);
    const std::int32_t second = next_above(columns, left.end, level);
    if (second == columns.num) return;
    const Light right = light_from(columns, second, level);
    if (next_above(columns, right.end, level) != columns.num) return;  // three lights
    const std::int32_t rise = top_of<Pixel>(image, box, left, level) - top_of<Pixel>(image, box, right, level);
    if (!are_alike(left, right, rise)) return;
    columns_px[0] = box.x1 + left.column + 0.5;
    columns_px[1] = box.x1 + right.column + 0.5;
}

}  // namespace

void twin_lights(const ImageView& image, const Box* boxes, std::size_t num_boxes, double* columns_px) {
    for (std::size_t i = 0; i < num_boxes; ++i) {
        if (image.pixel_type == PixelType::u8) {
            twins_of<std::uint8_t>(image, boxes[i], columns_px + 2 * i);
        } else {
            twins_of<std::uint16_t>(image, boxes[i], columns_px + 2 * i);
        }
    }
}

}  // namespace foreglow
