#include "foreglow/lamp_pairs.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace foreglow {
namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();

// Of the brighter to the darker light, and the product of the ratios of widths and of heights.
constexpr double max_contrast_ratio = 1.5, max_size_ratio = 2.2;
// Difference of height, and distance, in heights of the lower box.
constexpr double max_rise = 0.35, max_spacing = 16.0;
// In widths of the wider box: what overlaps more is one light.
constexpr double min_spacing = 0.8;

struct Light {
    double left, up, width, height, log_width, log_height, log_contrast;
};

// How unlike two lights are as partners, infinity if they are none.
double cost(const Light& one, const Light& other) {
    static const double max_log_size = std::log(max_size_ratio), max_log_contrast = std::log(max_contrast_ratio);
    const double across = std::abs(one.left - other.left), rise = std::abs(one.up - other.up);
    const double height = std::min(one.height, other.height), width = std::max(one.width, other.width);
    const double unlike = std::abs(one.log_width - other.log_width) + std::abs(one.log_height - other.log_height);
    const bool is_pair = rise < max_rise * height && across > min_spacing * width && across < max_spacing * height &&
                         unlike < max_log_size && std::abs(one.log_contrast - other.log_contrast) < max_log_contrast;
    // Nearer partners first: beyond them may be another vehicle.
    return is_pair ? rise / height + unlike + 0.03 * across / height : infinity;
}

}  // namespace

void pair_spacings(const double* centres_rad, const double* sizes_rad, const double* contrasts, std::size_t num,
                   double* spacings_rad) {
    std::vector<Light> lights(num);
    for (std::size_t i = 0; i < num; ++i) {
        const double width = sizes_rad[2 * i], height = sizes_rad[2 * i + 1];
        lights[i] = {centres_rad[2 * i], centres_rad[2 * i + 1], width,
                     height,             std::log(width),        std::log(height),
                     std::log(contrasts[i])};
    }
    std::vector<std::size_t> partners(num, num);
    std::vector<double> least(num, infinity);
    for (std::size_t i = 0; i < num; ++i) {
        for (std::size_t j = 0; j < num; ++j) {
            const double its = i == j ? infinity : cost(lights[i], lights[j]);
            if (its < least[i]) {
                least[i] = its;
                partners[i] = j;
            }
        }
    }
    for (std::size_t i = 0; i < num; ++i) {
        const std::size_t partner = partners[i];
        const bool is_mutual = partner < num && partners[partner] == i;
        spacings_rad[i] = is_mutual ? std::abs(lights[i].left - lights[partner].left)
                                    : std::numeric_limits<double>::quiet_NaN();
    }
}

}  // namespace foreglow
