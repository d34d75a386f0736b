#include "foreglow/crops.hpp"

#include <algorithm>
#include <cstring>
#include <limits>
#include <type_traits>
#include <utility>
#include <vector>

#ifdef __SSE2__
#include <emmintrin.h>
#endif

namespace foreglow {
namespace {

// Bilinear arithmetic of one pixel type: a horizontal sum of two pixels, then a vertical sum of two such sums.
template <typename Pixel>
struct Arithmetic;

// Fixed point with weights of 11 bits and one rounding more between the passes: what OpenCV's INTER_LINEAR does to
// 8-bit images, to the last bit, so that crops are those the published network was trained on.
template <>
struct Arithmetic<std::uint8_t> {
    using Weight = std::int16_t;
    using Sum = std::int16_t;

    static Weight weight(float fraction) {
        constexpr float to_integer = 8388608.0F;  // 2^23: what is added to it is rounded to the nearest, ties to even
        return static_cast<Weight>((fraction * 2048.0F + to_integer) - to_integer);
    }
    static Sum across(const std::uint8_t* near, std::int32_t to_far, const Weight* weights) {
        return static_cast<Sum>((near[0] * weights[0] + near[to_far] * weights[1]) >> 4);  // at most 255 * 128
    }
    static std::uint8_t down(Sum upper, Sum lower, Weight upper_weight, Weight lower_weight) {
        const auto upper_part = static_cast<std::int16_t>((upper * upper_weight) >> 16);
        const auto lower_part = static_cast<std::int16_t>((lower * lower_weight) >> 16);
        return static_cast<std::uint8_t>((upper_part + lower_part + 2) >> 2);
    }
};

// Single precision, rounded to whole grey levels: within one level of 65,535 of OpenCV.
template <>
struct Arithmetic<std::uint16_t> {
    using Weight = float;
    using Sum = float;

    static Weight weight(float fraction) { return fraction; }
    static Sum across(const std::uint16_t* near, std::int32_t to_far, const Weight* weights) {
        return near[0] * weights[0] + near[to_far] * weights[1];
    }
    static std::uint16_t down(Sum upper, Sum lower, Weight upper_weight, Weight lower_weight) {
        return static_cast<std::uint16_t>(static_cast<std::int32_t>(upper * upper_weight + lower * lower_weight + 0.5F));
    }
};

#ifdef __SSE2__
// Eight times `Arithmetic<std::uint8_t>::across` with the far pixel next to the near one.
inline void sum_eight_across(const std::uint8_t* row, const std::int32_t* near, const std::int16_t* weights,
                             std::int16_t* sums) {
    const auto pair = [&](int j) {
        std::uint16_t pixels;
        std::memcpy(&pixels, row + near[j], sizeof pixels);
        return static_cast<short>(pixels);
    };
    const __m128i pairs = _mm_setr_epi16(pair(0), pair(1), pair(2), pair(3), pair(4), pair(5), pair(6), pair(7));
    const __m128i* eight_weights = reinterpret_cast<const __m128i*>(weights);
    const __m128i left = _mm_madd_epi16(_mm_unpacklo_epi8(pairs, _mm_setzero_si128()), _mm_loadu_si128(eight_weights));
    const __m128i right =
        _mm_madd_epi16(_mm_unpackhi_epi8(pairs, _mm_setzero_si128()), _mm_loadu_si128(eight_weights + 1));
    _mm_storeu_si128(reinterpret_cast<__m128i*>(sums),
                     _mm_packs_epi32(_mm_srai_epi32(left, 4), _mm_srai_epi32(right, 4)));
}
#endif

// Cuts, resizes and stretches regions of images; scratch memory is shared by all regions.
template <typename Pixel>
class Cropper {
    using Maths = Arithmetic<Pixel>;
    using Weight = typename Maths::Weight;
    using Sum = typename Maths::Sum;

  public:
    explicit Cropper(std::int32_t size_px)
        : size_(static_cast<std::size_t>(size_px)),
          near_(size_),
          weights_(2 * size_),
          sums_{std::vector<Sum>(size_), std::vector<Sum>(size_)},
          levels_(size_ * size_) {}

    // What a crop is stretched by.
    struct Range {
        Pixel lowest, highest;
    };

    // The crop of `region`, which must hold at least one pixel of the image, stretched by its own range.
    Range extract(const ImageView& image, const Box& region, float* crop) {
        resize(image, region);
        const Range range = extremes();
        stretch(range, [](float value) { return value; }, crop);
        return range;
    }

    // The crop of `region`, stretched by the range of another one and cut at 0 and 1.
    void extract_within(const Range& range, const ImageView& image, const Box& region, float* crop) {
        resize(image, region);
        stretch(range, [](float value) { return std::clamp(value, 0.0F, 1.0F); }, crop);
    }

  private:
    // Where an output pixel lies among the input pixels of one axis.
    struct Position {
        std::int32_t index;
        float fraction;
    };

    // Input pixels per output pixel, in OpenCV's order of rounding.
    double scale_of(std::int32_t length) const { return 1.0 / (static_cast<double>(size_) / length); }

    // Half-pixel centres; index -1 is the half pixel before the first centre.
    static Position position_of(std::size_t i, double scale) {
        const auto position = static_cast<float>((static_cast<double>(i) + 0.5) * scale - 0.5);
        const std::int32_t index = static_cast<std::int32_t>(double{position} + 1.0) - 1;  // floor, as position > -1
        return {index, position - static_cast<float>(index)};
    }

    template <typename Cut>
    void stretch(const Range& range, const Cut& cut, float* crop) const {
        if (range.lowest == range.highest) {
            std::fill(crop, crop + levels_.size(), 0.0F);
            return;
        }
        const auto length = static_cast<float>(range.highest - range.lowest);
        for (std::size_t i = 0; i < levels_.size(); ++i) {
            crop[i] = cut(static_cast<float>(levels_[i] - range.lowest) / length);
        }
    }

    void resize(const ImageView& image, const Box& region) {
        const std::int32_t left = region.x1, top = region.y1;
        const std::int32_t width = region.x2 - region.x1, height = region.y2 - region.y1;
        const double column_scale = scale_of(width), row_scale = scale_of(height);
        for (std::size_t j = 0; j < size_; ++j) {
            Position position = position_of(j, column_scale);
            if (position.index < 0) position = {0, 0.0F};
            // The last column is read as the far one, so that the far one always exists.
            if (position.index >= width - 1) position = {std::max(width - 2, 0), 1.0F};
            near_[j] = position.index;
            weights_[2 * j] = Maths::weight(1.0F - position.fraction);
            weights_[2 * j + 1] = Maths::weight(position.fraction);
        }
        const std::int32_t to_far = width > 1 ? 1 : 0;
        std::int32_t rows[2] = {-1, -1};  // which row of the region each of `sums_` holds
        for (std::size_t i = 0; i < size_; ++i) {
            const Position position = position_of(i, row_scale);
            const std::int32_t upper = std::clamp(position.index, 0, height - 1);
            const std::int32_t lower = std::clamp(position.index + 1, 0, height - 1);
            if (rows[0] != upper && rows[1] == upper) {
                std::swap(sums_[0], sums_[1]);
                std::swap(rows[0], rows[1]);
            }
            const std::int32_t wanted[2] = {upper, lower};
            for (int k = 0; k < 2; ++k) {
                if (rows[k] == wanted[k]) continue;
                sum_across(image.row<Pixel>(top + wanted[k]) + left, to_far, sums_[k].data());
                rows[k] = wanted[k];
            }
            sum_down(Maths::weight(1.0F - position.fraction), Maths::weight(position.fraction), &levels_[i * size_]);
        }
    }

    void sum_across(const Pixel* row, std::int32_t to_far, Sum* sums) const {
        std::size_t j = 0;
#ifdef __SSE2__  // part of every x86-64
        if constexpr (std::is_same_v<Pixel, std::uint8_t>) {
            if (to_far == 1) {
                for (; j + 8 <= size_; j += 8) sum_eight_across(row, &near_[j], &weights_[2 * j], sums + j);
            }
        }
#endif
        for (; j < size_; ++j) sums[j] = Maths::across(row + near_[j], to_far, &weights_[2 * j]);
    }

    void sum_down(Weight upper_weight, Weight lower_weight, Pixel* levels) const {
        const Sum* upper = sums_[0].data();
        const Sum* lower = sums_[1].data();
        for (std::size_t j = 0; j < size_; ++j) {
            levels[j] = Maths::down(upper[j], lower[j], upper_weight, lower_weight);
        }
    }

    Range extremes() const {
        Pixel lowest = levels_[0], highest = levels_[0];
        for (const Pixel level : levels_) {
            lowest = std::min(lowest, level);
            highest = std::max(highest, level);
        }
        return {lowest, highest};
    }

    std::size_t size_;
    std::vector<std::int32_t> near_;
    std::vector<Weight> weights_;  // near and far in turn
    std::vector<Sum> sums_[2];
    std::vector<Pixel> levels_;
};

// The region of the image that belongs to `box`; without a pixel where it lies outside.
Box region_of(const Box& box, const ImageView& image, std::int64_t support) {
    const std::int64_t width = std::int64_t{box.x2} - box.x1, height = std::int64_t{box.y2} - box.y1;
    const std::int64_t x = box.x1 + width / 2, y = box.y1 + height / 2;
    const auto clip = [](std::int64_t value, std::int32_t limit) {
        return static_cast<std::int32_t>(std::clamp<std::int64_t>(value, 0, limit));
    };
    return {clip(x - support * width, image.width_px), clip(y - support * height, image.height_px),
            clip(x + support * width, image.width_px), clip(y + support * height, image.height_px)};
}

template <typename Pixel>
void extract_all(const ImageView& image, const ImageView* earlier, const Box* boxes, std::size_t num_boxes,
                 const CropSpec& spec, float* crops, float* levels) {
    Cropper<Pixel> cropper(spec.size_px);
    constexpr auto full_scale = static_cast<float>(std::numeric_limits<Pixel>::max());
    const std::size_t num_pixels = static_cast<std::size_t>(spec.size_px) * static_cast<std::size_t>(spec.size_px);
    const std::size_t num_channels = earlier == nullptr ? 1 : 2;
    for (std::size_t i = 0; i < num_boxes; ++i) {
        float* crop = crops + i * num_channels * num_pixels;
        const Box region = region_of(boxes[i], image, spec.support);
        if (region.x1 >= region.x2 || region.y1 >= region.y2) {
            std::fill(crop, crop + num_channels * num_pixels, 0.0F);
            levels[2 * i] = levels[2 * i + 1] = 0.0F;
            continue;
        }
        const auto range = cropper.extract(image, region, crop);
        levels[2 * i] = static_cast<float>(range.lowest) / full_scale;
        levels[2 * i + 1] = static_cast<float>(range.highest) / full_scale;
        if (earlier != nullptr) cropper.extract_within(range, *earlier, region, crop + num_pixels);
    }
}

}  // namespace

void extract_crops(const ImageView& image, const ImageView* earlier, const Box* boxes, std::size_t num_boxes,
                   const CropSpec& spec, float* crops, float* levels) {
    if (image.pixel_type == PixelType::u8) {
        extract_all<std::uint8_t>(image, earlier, boxes, num_boxes, spec, crops, levels);
    } else {
        extract_all<std::uint16_t>(image, earlier, boxes, num_boxes, spec, crops, levels);
    }
}

}  // namespace foreglow
