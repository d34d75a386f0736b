#include "foreglow/crops.hpp"

#include <algorithm>
#include <cstring>
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

// Cuts, resizes and stretches regions of one image; scratch memory is shared by all regions.
template <typename Pixel>
class Cropper {
    using Maths = Arithmetic<Pixel>;
    using Weight = typename Maths::Weight;
    using Sum = typename Maths::Sum;

  public:
    Cropper(const ImageView& image, std::int32_t size_px)
        : image_(image),
          size_(static_cast<std::size_t>(size_px)),
          near_(size_),
          weights_(2 * size_),
          sums_{std::vector<Sum>(size_), std::vector<Sum>(size_)},
          levels_(size_ * size_) {}

    // The region must hold at least one pixel of the image.
    void extract(std::int32_t left, std::int32_t top, std::int32_t right, std::int32_t bottom, float* crop) {
        resize(left, top, right - left, bottom - top);
        const auto [lowest, highest] = extremes();
        if (lowest == highest) {
            std::fill(crop, crop + levels_.size(), 0.0F);
            return;
        }
        const auto range = static_cast<float>(highest - lowest);
        for (std::size_t i = 0; i < levels_.size(); ++i) crop[i] = static_cast<float>(levels_[i] - lowest) / range;
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

    void resize(std::int32_t left, std::int32_t top, std::int32_t width, std::int32_t height) {
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
                sum_across(image_.row<Pixel>(top + wanted[k]) + left, to_far, sums_[k].data());
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

    std::pair<Pixel, Pixel> extremes() const {
        Pixel lowest = levels_[0], highest = levels_[0];
        for (const Pixel level : levels_) {
            lowest = std::min(lowest, level);
            highest = std::max(highest, level);
        }
        return {lowest, highest};
    }

    const ImageView& image_;
    std::size_t size_;
    std::vector<std::int32_t> near_;
    std::vector<Weight> weights_;  // near and far in turn
    std::vector<Sum> sums_[2];
    std::vector<Pixel> levels_;
};

template <typename Pixel>
void extract_all(const ImageView& image, const Box* boxes, std::size_t num_boxes, std::int32_t support,
                 std::int32_t size_px, float* crops) {
    Cropper<Pixel> cropper(image, size_px);
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
        } else {
            cropper.extract(left, top, right, bottom, crop);
        }
    }
}

}  // namespace

void extract_crops(const ImageView& image, const Box* boxes, std::size_t num_boxes, std::int32_t support,
                   std::int32_t size_px, float* crops) {
    if (image.pixel_type == PixelType::u8) {
        extract_all<std::uint8_t>(image, boxes, num_boxes, support, size_px, crops);
    } else {
        extract_all<std::uint16_t>(image, boxes, num_boxes, support, size_px, crops);
    }
}

}  // namespace foreglow
