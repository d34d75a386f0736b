#include "adaptive_threshold.hpp"

#include <algorithm>
#include <cmath>

namespace foreglow {
namespace {

std::int64_t round_up(std::int64_t value, std::int64_t quantum) { return (value + quantum - 1) / quantum * quantum; }

double smallest_tap(const HalfKernel& kernel) {
    double smallest = kernel[0];
    for (const double tap : kernel) {
        if (tap > 0.0) smallest = std::min(smallest, tap);
    }
    return smallest;
}

}  // namespace

AdaptiveThreshold::AdaptiveThreshold(const ProposalParameters& parameters, const Kernels& kernels)
    : parameters_(parameters),
      kernels_(kernels),
      across_(gaussian_taps(parameters.blur_width_px, parameters.blur_sigma_px)),
      down_(gaussian_taps(parameters.blur_height_px, parameters.blur_sigma_px)) {}

bool AdaptiveThreshold::start(const WorkingImage& image, std::int32_t half_window_px) {
    image_ = &image;
    half_window_px_ = half_window_px;
    next_ = entered_ = entering_slot_ = centre_slot_ = num_doubtful_ = 0;
    black_ = parameters_.normalise ? image.darkest : 0;
    range_ = (parameters_.normalise ? image.brightest : image.full_scale) - black_;
    if (range_ == 0) return false;
    arrange();
    measure();
    return true;
}

BinaryRow AdaptiveThreshold::next_row() {
    for (; entered_ <= next_ + after_; ++entered_) enter_row(entered_);
    threshold_row(next_++);
    return {bits_.data(), bits_.data() + words_, words_};
}

AdaptiveThreshold::Span AdaptiveThreshold::span(std::int64_t position, std::int64_t length) const {
    const std::int64_t last = std::min(length - 1, position + after_) + 1;
    return {std::min(std::max(first_, position - before_), last), last};
}

// Everything that depends on the image's size alone; a no-op while that stays the same.
void AdaptiveThreshold::arrange() {
    const bool is_published = parameters_.window == Window::published;
    if (arranged_width_ == image_->width && window_rows_ == 2 * half_window_px_ + (is_published ? 0 : 1)) return;
    arranged_width_ = image_->width;
    first_ = is_published ? 1 : 0;
    before_ = is_published ? half_window_px_ - 1 : half_window_px_;
    after_ = half_window_px_;
    window_rows_ = before_ + after_ + 1;
    plane_ = round_up((image_->width + 1) / 2, plane_quantum);
    words_ = plane_ / 64;
    pad_ = round_up(half_window_px_ / 2 + 2, 16);

    const auto fill = [](auto& values, std::int64_t size, auto value) {
        values.assign(static_cast<std::size_t>(size), value);
    };
    fill(blurred_rows_, 3 * 2 * plane_, 0.0F);
    fill(levels_, window_rows_ * 2 * plane_, level_zero);
    fill(no_levels_, 2 * plane_, level_zero);
    fill(no_light_, 2 * plane_, 0.0F);
    fill(column_sums_, 2 * (plane_ + 2 * pad_), 0U);
    fill(running_, plane_ + 2 * pad_, 0U);
    fill(inverse_columns_, 2 * plane_, 0.0F);
    fill(inverse_areas_, 2 * plane_, 0.0F);
    fill(quick_areas_, 2 * plane_, 0.0F);
    fill(bits_, 2 * words_, std::uint64_t{0});
    fill(doubt_, 2 * words_, std::uint64_t{0});
    for (std::int64_t x = 0; x < image_->width; ++x) {
        const Span columns = span(x, image_->width);
        inverse_columns_[static_cast<std::size_t>((x % 2) * plane_ + x / 2)] =
            1.0F / static_cast<float>(std::max<std::int64_t>(columns.last - columns.first, 1));
    }
    inverse_rows_ = 0;
}

// Units and tolerances for the current image.
void AdaptiveThreshold::measure() {
    std::fill(column_sums_.begin(), column_sums_.end(), 0U);
    // Levels are as fine as 32-bit sums over a window and 24-bit floats allow.
    const auto area = static_cast<double>(window_rows_ * window_rows_);
    unit_ = std::exp2(std::min(22.0, std::floor(std::log2(2147483647.0 / area) - 1e-3)));
    double across_sum = 1.0;
    off_ = 1.0;
    if (image_->is_narrow) {
        const WholeTaps& whole = whole_taps_for(image_->full_scale);
        std::copy(whole.taps.begin(), whole.taps.end(), across_taps_.taps);
        across_taps_.bias = static_cast<std::int32_t>(black_ * whole.sum);
        across_sum = whole.sum;
        off_ += unit_ * whole.error;
    }
    const double to_levels = unit_ / (across_sum * static_cast<double>(range_));
    outer_tap_ = static_cast<float>(down_[1] * to_levels);
    centre_tap_ = static_cast<float>(down_[0] * to_levels);

    // How far single precision can move D (1 + eps - D) - kappa mean (1 + eps - 2 D) near its zero, where
    // I <= (1 + kappa) mean: I and the mean are off by `off_` levels each, and by blur_error of themselves.
    const double kappa = parameters_.kappa;
    constexpr double blur_error = 1e-6;
    tolerance_ = static_cast<float>(1.5 * unit_ * off_ * (2.0 + 5.0 * kappa));
    tolerance_slope_ = static_cast<float>(
        1.5 * unit_ *
        (((1.0 + 2.0 * kappa) * (1.0 + kappa) + 1.0 + 3.0 * kappa) * blur_error + 3e-7 * (1.0 + 2.0 * kappa)));
    // The faintest blurred pixel that is not black; where it spans levels, level 0 is exactly black.
    const double faintest = smallest_tap(across_) * smallest_tap(down_) * unit_ / static_cast<double>(range_);
    surely_black_ = faintest > 2.0 + off_ ? 0.5F : -1.0F;

    // What is not above least(mean) = min(mean (1 + rise), most) is not above T. With rise = kappa (1 - d / (1 - d)):
    // while D < d, T > mean (1 + rise); where D >= d, I >= mean + d, which is above mean (1 + rise) for means
    // below d / rise and above most = d + d / rise for the others.
    constexpr double d = 0.1;
    quick_rise_ = kappa * (1.0 - d / (1.0 - d));
    quick_most_ = static_cast<float>(unit_ * std::min(1.0, 0.999 * (d + d / quick_rise_)));
}

const WholeTaps& AdaptiveThreshold::whole_taps_for(std::int64_t largest_sum) {
    if (whole_taps_largest_ != largest_sum) {
        whole_taps_ = whole_taps(across_, largest_sum);
        whole_taps_largest_ = largest_sum;
    }
    return whole_taps_;
}

void AdaptiveThreshold::blur_across(std::int64_t y) {
    float* row = blurred_row(y);
    if (image_->is_narrow) {
        kernels_.blur_across(image_->narrow_row(y), across_taps_, plane_, row, row + plane_);
        for (std::int64_t parity : {even, odd}) {
            std::fill(row + parity * plane_ + num_columns(parity), row + (parity + 1) * plane_, 0.0F);
        }
        return;
    }
    const std::uint32_t* sums = image_->wide_row(y);
    const auto value = [&](std::int64_t x) { return static_cast<float>(static_cast<std::int64_t>(sums[x]) - black_); };
    const auto centre = static_cast<float>(across_[0]), near = static_cast<float>(across_[1]),
               far = static_cast<float>(across_[2]);
    for (std::int64_t x = 0; x < image_->width; ++x) {
        row[(x % 2) * plane_ + x / 2] =
            far * (value(x - 2) + value(x + 2)) + near * (value(x - 1) + value(x + 1)) + centre * value(x);
    }
}

// Row y enters the window and the row that it pushes out leaves; below the image, rows of nothing enter.
void AdaptiveThreshold::enter_row(std::int64_t y) {
    const std::int64_t height = image_->height;
    if (y == 0) blur_across(0);
    if (y + 1 < height) blur_across(y + 1);
    WindowStep step{};
    if (y < height) {
        step.above = blurred_row(mirrored(y - 1, height));
        step.here = blurred_row(y);
        step.below = blurred_row(mirrored(y + 1, height));
    } else {
        step.above = step.here = step.below = no_light_.data();
    }
    step.outer = outer_tap_;
    step.centre = centre_tap_;
    step.levels = level_row(entering_slot_);  // where the row lies that leaves
    step.leaving = y - window_rows_ >= first_ ? step.levels : no_levels_.data();
    step.length = plane_;
    step.even_sums = column_sums(even);
    step.odd_sums = column_sums(odd);
    step.running = running_.data() + pad_;
    step.running_length = plane_ + pad_;
    kernels_.step_window(step);
    entering_slot_ = slot_after(entering_slot_);
    if (y < first_) std::fill(column_sums_.begin(), column_sums_.end(), 0U);
    if (first_ == 1) {  // the published window never reads column 0: every running sum starts behind it
        std::fill(running_.begin(), running_.begin() + pad_, column_sums(even)[0]);
        column_sums(even)[0] = 0;
    }
}

void AdaptiveThreshold::update_areas(std::int64_t num_rows) {
    if (num_rows == inverse_rows_) return;
    inverse_rows_ = num_rows;
    const float scale = 1.0F / static_cast<float>(num_rows);
    const auto quick = static_cast<float>((1.0 + quick_rise_) * (1.0 - 1e-5));
    for (std::size_t i = 0; i < inverse_columns_.size(); ++i) {
        inverse_areas_[i] = inverse_columns_[i] * scale;
        quick_areas_[i] = inverse_areas_[i] * quick;
    }
}

void AdaptiveThreshold::threshold_row(std::int64_t y) {
    const Span rows = span(y, image_->height);
    update_areas(std::max<std::int64_t>(rows.last - rows.first, 1));
    // The window of an even column spans start .. stop, relative to it.
    const std::int64_t start = -before_, stop = after_;
    const auto halved = [](std::int64_t value) { return (value - (value & 1)) / 2; };  // towards minus infinity
    const auto column = [&](std::int64_t x) { return column_sums(x & 1) + halved(x); };
    const std::uint32_t* running = running_.data() + pad_;
    ThresholdRow row{};
    row.length = plane_;
    row.levels = level_row(centre_slot_);
    row.inverse_areas = inverse_areas_.data();
    row.quick_areas = quick_areas_.data();
    row.quick_slack = static_cast<float>(off_ * (4.0 + parameters_.kappa));
    row.quick_most = quick_most_;
    row.pairs_stop = running + halved(stop + 1) - 1;
    row.pairs_start = running + halved(start + 1) - 1;
    row.single_start = (start & 1) != 0 ? column(start) : nullptr;
    row.single_stop = (stop & 1) == 0 ? column(stop) : nullptr;
    row.leaving = column(start);
    row.entering = column(stop + 1);
    row.unit_plus_eps = static_cast<float>(unit_ * (1.0 + parameters_.eps));
    row.kappa = static_cast<float>(parameters_.kappa);
    row.tolerance = tolerance_;
    row.tolerance_slope = tolerance_slope_;
    row.surely_black = surely_black_;
    row.above = bits_.data();
    row.doubt = doubt_.data();
    const bool has_doubt = kernels_.exceed(row);
    centre_slot_ = slot_after(centre_slot_);
    for (std::int64_t parity : {even, odd}) {  // nothing beyond the image counts
        const std::int64_t used = num_columns(parity);
        for (std::int64_t word = used / 64; word < words_; ++word) {
            const std::uint64_t inside = word * 64 < used ? (1ULL << (used % 64)) - 1 : 0;
            bits_[static_cast<std::size_t>(parity * words_ + word)] &= inside;
            doubt_[static_cast<std::size_t>(parity * words_ + word)] &= inside;
        }
    }
    if (has_doubt) settle_doubt(y, rows);
}

// Decides in double precision what single precision could not.
void AdaptiveThreshold::settle_doubt(std::int64_t y, Span rows) {
    const ExactBlur blur = exact();
    for (std::int64_t word = 0; word < 2 * words_; ++word) {
        for (std::uint64_t doubt = doubt_[static_cast<std::size_t>(word)]; doubt != 0; doubt &= doubt - 1) {
            const int bit = __builtin_ctzll(doubt);
            const std::int64_t parity = word / words_, x = 2 * ((word % words_) * 64 + bit) + parity;
            const Span columns = span(x, image_->width);
            const Box window = {static_cast<std::int32_t>(columns.first), static_cast<std::int32_t>(rows.first),
                                static_cast<std::int32_t>(columns.last), static_cast<std::int32_t>(rows.last)};
            const auto area = static_cast<double>((columns.last - columns.first) * (rows.last - rows.first));
            const double value = blur.at(x, y);
            bool is_above = value > rounding;  // what is black is below any mean's threshold
            if (is_above) {
                const double mean = area > 0.0 ? blur.sum_over(window) / area : 0.0;
                const double difference = value - mean;
                const double contrast = difference / (1.0 - difference + parameters_.eps);
                is_above = value > mean * (1.0 + parameters_.kappa * (1.0 - contrast)) + rounding;
            }
            const std::uint64_t mask = 1ULL << bit;
            std::uint64_t& bits = bits_[static_cast<std::size_t>(word)];
            bits = is_above ? bits | mask : bits & ~mask;
            ++num_doubtful_;
        }
    }
}

}  // namespace foreglow
