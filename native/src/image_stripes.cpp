#include "foreglow/image_stripes.hpp"

#include <algorithm>
#include <cstddef>
#include <cstdlib>

namespace foreglow {
namespace {

constexpr std::int64_t max_bands = 16, band_px = 32;  // bands of so many adjacent rows
constexpr std::int64_t least_across = 128;            // pixels of each row, at most twice as many
constexpr double least_change = 0.05;                 // 8-bit grey levels: in the dark nothing may change
constexpr double top_level = 255.0;                   // the greatest value has so many 8-bit grey levels

std::uint32_t difference(std::int32_t one, std::int32_t other) {
    return static_cast<std::uint32_t>(std::abs(one - other));
}

// Reorders the values. The mean of the two middle ones of an even number; 0 without any.
double median(std::vector<double>& values) {
    if (values.empty()) return 0.0;
    const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    return values.size() % 2 ? *middle : 0.5 * (*middle + *std::max_element(values.begin(), middle));
}

}  // namespace

template <typename Pixel>
void ImageStripes::cut(const ImageView& image) {
    const std::int64_t sides[] = {image.height_px, image.width_px};
    for (std::size_t axis = 0; axis < 2; ++axis) {
        Bands& bands = now_[axis];
        const std::int64_t along = sides[axis], across = sides[1 - axis];
        const std::int64_t step = std::max<std::int64_t>(1, across / least_across);
        bands.num_in_band = std::min(band_px, along);
        bands.num = std::min(max_bands, along / bands.num_in_band);
        bands.num_across = (across - step / 2 + step - 1) / step;
        bands.pixels.resize(static_cast<std::size_t>(bands.num * bands.num_across * bands.num_in_band));
        for (std::int64_t band = 0; band < bands.num; ++band) {
            const std::int64_t start = band * (along - bands.num_in_band) / std::max<std::int64_t>(1, bands.num - 1);
            std::int32_t* to = bands.pixels.data() + band * bands.num_across * bands.num_in_band;
            if (axis == 0) {
                for (std::int64_t j = 0; j < bands.num_in_band; ++j) {
                    const Pixel* row = image.row<Pixel>(start + j) + step / 2;
                    for (std::int64_t i = 0; i < bands.num_across; ++i) to[i * bands.num_in_band + j] = row[i * step];
                }
            } else {
                for (std::int64_t i = 0; i < bands.num_across; ++i) {
                    const Pixel* from = image.row<Pixel>(step / 2 + i * step) + start;
                    std::copy(from, from + bands.num_in_band, to + i * bands.num_in_band);
                }
            }
        }
    }
}

Alternation ImageStripes::alternation(const Bands& before, const Bands& now, std::int32_t top) {
    const std::int64_t num = now.num_in_band;
    std::vector<double> changes;
    std::uint64_t near = 0, far = 0;
    const double levels = top_level / (static_cast<double>(top) * static_cast<double>(now.num_across));
    for (std::int64_t band = 0; band < now.num; ++band) {
        std::uint32_t sums[band_px] = {};
        for (std::int64_t i = 0; i < now.num_across; ++i) {
            const std::int64_t first = (band * now.num_across + i) * num;
            const std::int32_t* is = now.pixels.data() + first;
            const std::int32_t* was = before.pixels.data() + first;
            std::uint32_t near_here = 0, far_here = 0;
            for (std::int64_t j = 0; j < num; ++j) sums[j] += difference(is[j], was[j]);
            for (std::int64_t j = 0; j + 1 < num; ++j) near_here += difference(is[j], is[j + 1]);
            for (std::int64_t j = 0; j + 2 < num; ++j) far_here += difference(is[j], is[j + 2]);
            near += near_here;
            far += far_here;
        }
        for (std::int64_t j = 0; j < num; ++j) changes.push_back(levels * static_cast<double>(sums[j]));
    }
    Alternation found{};
    std::vector<double> ratios;
    for (std::size_t k = 0; k < stripe_lags_px.size(); ++k) {
        ratios.clear();
        for (std::int64_t band = 0; band < now.num; ++band) {
            const double* of = changes.data() + band * num;
            for (std::int64_t j = stripe_lags_px[k]; j < num; ++j) {
                const double one = of[j], other = of[j - stripe_lags_px[k]];
                ratios.push_back((std::max(one, other) - std::min(one, other)) / (one + other + least_change));
            }
        }
        found[k] = median(ratios);
    }
    const auto mean = [&](std::uint64_t sum, std::int64_t lag) {
        return num > lag ? levels * static_cast<double>(sum) / static_cast<double>(now.num * (num - lag)) : 0.0;
    };
    found.back() = mean(near, 1) / (mean(far, 2) + least_change);
    return found;
}

void ImageStripes::reset() { width_px_ = height_px_ = 0; }

bool ImageStripes::update(const ImageView& image, std::int32_t top, std::array<Alternation, 2>& found) {
    const bool is_same =
        image.width_px == width_px_ && image.height_px == height_px_ && image.pixel_type == pixel_type_;
    width_px_ = image.width_px;
    height_px_ = image.height_px;
    pixel_type_ = image.pixel_type;
    std::swap(before_, now_);
    image.pixel_type == PixelType::u8 ? cut<std::uint8_t>(image) : cut<std::uint16_t>(image);
    if (!is_same) return false;
    for (std::size_t axis = 0; axis < 2; ++axis) found[axis] = alternation(before_[axis], now_[axis], top);
    return true;
}

}  // namespace foreglow
