// The reduced frame that the proposal stage works on, in whole numbers, and its blur in double precision.
#pragma once

#include <cstdint>
#include <vector>

#include "aligned.hpp"
#include "foreglow/image.hpp"
#include "kernels.hpp"
#include "taps.hpp"

namespace foreglow {

// Block sums of a frame, 16 bits wide where they fit below 2^15 (`is_narrow`), else 32 bits.
class WorkingImage {
public:
    // Spare columns to either side of a row: the mirrored border, and what vector loads may touch.
    static constexpr std::int64_t margin = 64;

    // Sums whole blocks of `reduction` x `reduction` pixels; what fills no block is left out.
    void reduce(const ImageView& frame, std::int32_t reduction, const Kernels& kernels);

    std::int64_t width = 0, height = 0;
    bool is_narrow = true;
    std::int64_t darkest = 0, brightest = 0;  // extremes of the sums
    std::int64_t full_scale = 0;              // the sum of a saturated block

    const std::uint16_t* narrow_row(std::int64_t y) const { return narrow_.data() + y * stride_ + margin; }
    const std::uint32_t* wide_row(std::int64_t y) const { return wide_.data() + y * stride_ + margin; }
    template <typename Sum>
    const Sum* row(std::int64_t y) const {
        if constexpr (sizeof(Sum) == 2) {
            return narrow_row(y);
        } else {
            return wide_row(y);
        }
    }
    std::int64_t sum_at(std::int64_t y, std::int64_t x) const {
        return is_narrow ? narrow_row(y)[x] : static_cast<std::int64_t>(wide_row(y)[x]);
    }

private:
    template <typename Pixel, typename Sum>
    void sum_blocks(const ImageView& frame, std::int32_t reduction, AlignedVector<Sum>& sums);
    template <typename Sum>
    void mirror_border(AlignedVector<Sum>& sums) const;

    std::int64_t stride_ = 0;
    AlignedVector<std::uint16_t> narrow_;
    AlignedVector<std::uint32_t> wide_;
    std::vector<std::uint32_t> columns_;
};

// The blurred image in double precision, for single pixels, windows and boxes.
struct ExactBlur {
    const WorkingImage& image;
    const HalfKernel& across;
    const HalfKernel& down;
    std::int32_t black;  // the sum that counts as 0 ...
    double unit;         // ... and the distance from it that counts as 1

    // In 32 bits, so that compilers vectorise it.
    double level(std::uint32_t sum) const { return static_cast<double>(static_cast<std::int32_t>(sum) - black); }

    double at(std::int64_t x, std::int64_t y) const;

    // Sum over the half-open `window`; its weights are separable, so it needs no blurred pixel.
    double sum_over(const Box& window) const;

    // Mean absolute deviation from the mean over `box`; `scratch` keeps its memory.
    double deviation(const Box& box, std::vector<double>& scratch) const;
};

}  // namespace foreglow
