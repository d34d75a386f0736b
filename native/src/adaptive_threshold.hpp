// The paper's dynamic threshold, row by row: which pixels stand out against their local mean.
#pragma once

#include <cstdint>
#include <vector>

#include "aligned.hpp"
#include "foreglow/proposals.hpp"
#include "kernels.hpp"
#include "taps.hpp"
#include "working_image.hpp"

namespace foreglow {

// What counts as equal, in units of the dynamic range; see ROUNDING in foreglow/proposals/reference.py.
constexpr double rounding = 1e-10;

// One row of the binary image: bit i of even[w] is column 2 (64 w + i), of odd[w] the column after it.
struct BinaryRow {
    const std::uint64_t *even, *odd;
    std::int64_t num_words;
};

// Works in single precision and whole numbers, and in double precision where a pixel is too close to the threshold
// for that, so that every dispatch level finds the pixels of the reference. The image passes through once: a row is
// blurred when it enters the local mean's window, kept while it is in there, and forgotten.
class AdaptiveThreshold {
public:
    AdaptiveThreshold(const ProposalParameters& parameters, const Kernels& kernels);

    // Begins with `image`, which must stay as it is until the last row. Returns false for a flat image: no pixel is set.
    bool start(const WorkingImage& image, std::int32_t half_window_px);

    // The next row, from the top; its words stay until the next call.
    BinaryRow next_row();

    // The blurred image in double precision.
    ExactBlur exact() const {
        return {*image_, across_, down_, static_cast<std::int32_t>(black_), static_cast<double>(range_)};
    }

    // The block sum that counts as 0, and the distance from it that counts as 1.
    std::int64_t black() const { return black_; }
    std::int64_t range() const { return range_; }

    // Pixels since `start` that double precision decided.
    std::int64_t num_doubtful() const { return num_doubtful_; }

private:
    static constexpr std::int64_t even = 0, odd = 1;

    // The part of a window along one axis: positions first .. last - 1.
    struct Span {
        std::int64_t first, last;
    };

    void arrange();
    void measure();
    const WholeTaps& whole_taps_for(std::int64_t largest_sum);
    void blur_across(std::int64_t y);
    void enter_row(std::int64_t y);
    void update_areas(std::int64_t num_rows);
    void threshold_row(std::int64_t y);
    void settle_doubt(std::int64_t y, Span rows);

    float* blurred_row(std::int64_t y) { return blurred_rows_.data() + (y % 3) * 2 * plane_; }
    float* level_row(std::int64_t slot) { return levels_.data() + slot * 2 * plane_; }
    std::int64_t slot_after(std::int64_t slot) const { return slot + 1 == window_rows_ ? 0 : slot + 1; }
    std::uint32_t* column_sums(std::int64_t parity) { return column_sums_.data() + parity * (plane_ + 2 * pad_) + pad_; }
    std::int64_t num_columns(std::int64_t parity) const { return (image_->width + 1 - parity) / 2; }
    Span span(std::int64_t position, std::int64_t length) const;

    const ProposalParameters parameters_;
    const Kernels& kernels_;
    const HalfKernel across_, down_;
    WholeTaps whole_taps_;
    std::int64_t whole_taps_largest_ = -1;

    const WorkingImage* image_ = nullptr;
    std::int32_t half_window_px_ = 0;
    std::int64_t black_ = 0, range_ = 1;  // the sum that counts as 0, and the distance from it that counts as 1
    std::int64_t next_ = 0, entered_ = 0;
    std::int64_t entering_slot_ = 0, centre_slot_ = 0;  // places in the ring of levels: of the next row to enter, of next_
    std::int64_t num_doubtful_ = 0;

    // The window reaches from `before_` pixels before its centre to `after_` behind it and never reads a row or column
    // below `first_`.
    std::int64_t first_ = 0, before_ = 0, after_ = 0, window_rows_ = 0;
    std::int64_t arranged_width_ = -1, plane_ = 0, words_ = 0, pad_ = 0;

    double unit_ = 1.0;  // levels that make 1
    double off_ = 1.0;   // levels that a blurred pixel may be off by, rounding and whole taps together
    AcrossTaps across_taps_;
    float outer_tap_ = 0.0F, centre_tap_ = 0.0F;
    float tolerance_ = 0.0F, tolerance_slope_ = 0.0F, surely_black_ = -1.0F, quick_most_ = 0.0F;
    double quick_rise_ = 0.0;

    AlignedVector<float> blurred_rows_;          // three rows, blurred across
    AlignedVector<float> levels_;                // the window's rows, blurred, in a ring
    AlignedVector<float> no_levels_, no_light_;  // a row of level 0, and what it comes from
    AlignedVector<std::uint32_t> column_sums_;   // of the window's rows
    AlignedVector<std::uint32_t> running_;       // of column_sums_, in pairs
    AlignedVector<float> inverse_columns_, inverse_areas_, quick_areas_;
    std::int64_t inverse_rows_ = 0;
    std::vector<std::uint64_t> bits_, doubt_;  // one row: even words, odd words
};

}  // namespace foreglow
