#include "taps.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace foreglow {

HalfKernel gaussian_taps(std::int32_t size, double sigma_px) {
    HalfKernel taps{};
    double sum = 0.0;
    for (std::int32_t k = 0; k <= size / 2; ++k) {
        taps[k] = std::exp(-0.5 * (k / sigma_px) * (k / sigma_px));
        sum += k == 0 ? taps[k] : 2.0 * taps[k];
    }
    for (double& tap : taps) tap /= sum;
    return taps;
}

WholeTaps whole_taps(const HalfKernel& kernel, std::int64_t largest_value) {
    const double largest_sum = 2147483647.0 / static_cast<double>(std::max<std::int64_t>(largest_value, 1)) - 4.0;
    const auto last = static_cast<std::int32_t>(std::min(32767.0, largest_sum * kernel[0]));
    WholeTaps best;
    best.error = std::numeric_limits<double>::infinity();
    for (std::int32_t centre = std::max(1, last / 2); centre <= last; ++centre) {
        const auto near = std::lround(centre * kernel[1] / kernel[0]), far = std::lround(centre * kernel[2] / kernel[0]);
        const double sum = static_cast<double>(centre + 2 * near + 2 * far);
        double error = 0.0;
        const std::array<double, 3> taps = {static_cast<double>(centre), static_cast<double>(near),
                                            static_cast<double>(far)};
        for (std::size_t k = 0; k < taps.size(); ++k) {
            error += (k == 0 ? 1.0 : 2.0) * std::abs(taps[k] / sum - kernel[k]);
        }
        if (error < best.error) {
            best.taps = {static_cast<std::int16_t>(centre), static_cast<std::int16_t>(near),
                         static_cast<std::int16_t>(far)};
            best.sum = static_cast<std::int32_t>(sum);
            best.error = error;
        }
    }
    return best;
}

}  // namespace foreglow
