#include "foreglow/proposals.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <tuple>

#include "aligned.hpp"
#include "blobs.hpp"
#include "dispatch.hpp"
#include "kernels.hpp"
#include "taps.hpp"
#include "working_image.hpp"

namespace foreglow {
namespace {

void require(bool holds, const char* message) {
    if (!holds) throw std::invalid_argument(message);
}

const ProposalParameters& checked(const ProposalParameters& p) {
    require(p.kappa >= 0.0 && p.kappa <= 10.0, "kappa: expected 0..10");
    require(p.window_px >= 2 && p.window_px <= 512, "window_px: expected 2..512");
    require(p.eps > 0.0 && p.eps <= 1.0, "eps: expected above 0, at most 1");
    require(p.min_deviation >= 0.0 && p.min_deviation <= 1.0, "min_deviation: expected 0..1");
    require(p.gap_px >= 1 && p.gap_px <= 64, "gap_px: expected 1..64");
    require(p.min_area_px >= 0.0 && p.max_area_px > 0.0 && p.min_width_px >= 0.0,
            "min_area_px, max_area_px, min_width_px: expected positive numbers");
    require(p.reduction >= 1 && p.reduction <= 16, "reduction: expected 1..16");
    require(p.reference_width_px >= 64 && p.reference_width_px <= 16384, "reference_width_px: expected 64..16384");
    require(p.blur_width_px == 1 || p.blur_width_px == 3 || p.blur_width_px == 5, "blur_width_px: expected 1, 3 or 5");
    require(p.blur_height_px == 1 || p.blur_height_px == 3, "blur_height_px: expected 1 or 3");
    require(p.blur_sigma_px > 0.0 && p.blur_sigma_px <= 100.0, "blur_sigma_px: expected above 0, at most 100");
    if (p.region) {
        require(p.region->x1 >= 0 && p.region->x1 < p.region->x2 && p.region->y1 >= 0 && p.region->y1 < p.region->y2,
                "region_xyxy_px: expected 0 <= x1 < x2 and 0 <= y1 < y2");
    }
    return p;
}

std::int64_t round_up(std::int64_t value, std::int64_t quantum) { return (value + quantum - 1) / quantum * quantum; }

// What counts as equal, in units of the dynamic range; see ROUNDING in foreglow/proposals/reference.py.
constexpr double rounding = 1e-10;

// The part of a local mean's window along one axis: positions first .. last - 1.
struct Span {
    std::int64_t first, last;
};

}  // namespace

WorkingSizes working_sizes(const ProposalParameters& p, std::int32_t width_px) {
    const auto whole = [](double value) { return static_cast<std::int32_t>(std::max(1.0, std::floor(value + 0.5))); };
    WorkingSizes sizes;
    sizes.reduction = whole(static_cast<double>(std::int64_t{p.reduction} * width_px) / p.reference_width_px);
    const double ratio = static_cast<double>(width_px / sizes.reduction) /
                         (static_cast<double>(p.reference_width_px) / p.reduction);
    sizes.half_window_px = whole(p.window_px / 2 * ratio);
    sizes.gap_px = whole(p.gap_px * ratio);
    sizes.min_area_px = p.min_area_px * ratio * ratio;
    sizes.max_area_px = p.max_area_px * ratio * ratio;
    sizes.min_width_px = p.min_width_px * ratio;
    return sizes;
}

class ProposalGenerator::Impl {
public:
    Impl(const ProposalParameters& parameters, std::optional<Dispatch> dispatch)
        : parameters_(checked(parameters)),
          dispatch_(dispatch.value_or(available_dispatch().back())),
          kernels_(kernels_for(dispatch_)),
          across_(gaussian_taps(parameters.blur_width_px, parameters.blur_sigma_px)),
          down_(gaussian_taps(parameters.blur_height_px, parameters.blur_sigma_px)) {}

    const std::vector<Box>& propose(const ImageView& frame) {
        boxes_.clear();
        num_doubtful_ = 0;
        sizes_ = working_sizes(parameters_, frame.width_px);
        require(sizes_.reduction <= 64, "image: too wide for reference_width_px");
        ImageView region = frame;
        std::int32_t left = 0, top = 0;
        if (parameters_.region) {
            left = parameters_.region->x1;
            top = parameters_.region->y1;
            region.width_px = std::min(frame.width_px, parameters_.region->x2) - left;
            region.height_px = std::min(frame.height_px, parameters_.region->y2) - top;
            if (region.width_px <= 0 || region.height_px <= 0) return boxes_;
            const std::int64_t pixel_bytes = frame.pixel_type == PixelType::u8 ? 1 : 2;
            region.data = frame.row<char>(top) + left * pixel_bytes;
        }
        image_.reduce(region, sizes_.reduction, kernels_);
        if (image_.width == 0 || image_.height == 0) return boxes_;
        black_ = parameters_.normalise ? image_.darkest : 0;
        range_ = (parameters_.normalise ? image_.brightest : image_.full_scale) - black_;
        if (range_ == 0) return boxes_;
        arrange();
        measure();
        find_blobs();
        keep_boxes(left, top);
        return boxes_;
    }

    Dispatch dispatch() const { return dispatch_; }
    std::int64_t num_doubtful() const { return num_doubtful_; }

private:
    static constexpr std::int64_t even = 0, odd = 1;

    // Everything that depends on the image's size alone; a no-op while that stays the same.
    void arrange() {
        const bool is_published = parameters_.window == Window::published;
        if (arranged_width_ == image_.width && window_rows_ == 2 * sizes_.half_window_px + (is_published ? 0 : 1)) return;
        arranged_width_ = image_.width;
        first_ = is_published ? 1 : 0;
        before_ = is_published ? sizes_.half_window_px - 1 : sizes_.half_window_px;
        after_ = sizes_.half_window_px;
        window_rows_ = before_ + after_ + 1;
        plane_ = round_up((image_.width + 1) / 2, plane_quantum);
        words_ = plane_ / 64;
        pad_ = round_up(sizes_.half_window_px / 2 + 2, 16);

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
        for (std::int64_t x = 0; x < image_.width; ++x) {
            const Span columns = span(x, image_.width);
            inverse_columns_[static_cast<std::size_t>((x % 2) * plane_ + x / 2)] =
                1.0F / static_cast<float>(std::max<std::int64_t>(columns.last - columns.first, 1));
        }
        inverse_rows_ = 0;
    }

    // Units and tolerances for the current image.
    void measure() {
        std::fill(column_sums_.begin(), column_sums_.end(), 0U);
        // Levels are as fine as 32-bit sums over a window and 24-bit floats allow.
        const auto area = static_cast<double>(window_rows_ * window_rows_);
        unit_ = std::exp2(std::min(22.0, std::floor(std::log2(2147483647.0 / area) - 1e-3)));
        double blur_error = 1e-6, across_sum = 1.0;
        if (image_.is_narrow) {
            const WholeTaps& whole = whole_taps_for(image_.full_scale);
            std::copy(whole.taps.begin(), whole.taps.end(), across_taps_.taps);
            across_taps_.bias = static_cast<std::int32_t>(black_ * whole.sum);
            across_sum = whole.sum;
            blur_error += whole.relative_error;
        }
        const double to_levels = unit_ / (across_sum * static_cast<double>(range_));
        outer_tap_ = static_cast<float>(down_[1] * to_levels);
        centre_tap_ = static_cast<float>(down_[0] * to_levels);

        // How far single precision can move D (1 + eps - D) - kappa mean (1 + eps - 2 D) near its zero, where
        // I <= (1 + kappa) mean: I and the mean are off by one level each, and by blur_error of themselves.
        const double kappa = parameters_.kappa;
        tolerance_ = static_cast<float>(1.5 * unit_ * (2.0 + 5.0 * kappa));
        tolerance_slope_ = static_cast<float>(
            1.5 * unit_ *
            (((1.0 + 2.0 * kappa) * (1.0 + kappa) + 1.0 + 3.0 * kappa) * blur_error + 3e-7 * (1.0 + 2.0 * kappa)));
        // The faintest blurred pixel that is not black; where it spans levels, level 0 is exactly black.
        const double faintest = smallest_tap(across_) * smallest_tap(down_) * unit_ / static_cast<double>(range_);
        surely_black_ = faintest > 3.0 ? 0.5F : -1.0F;

        // What is not above least(mean) = min(mean (1 + rise), most) is not above T. With rise = kappa (1 - d / (1 - d)):
        // while D < d, T > mean (1 + rise); where D >= d, I >= mean + d, which is above mean (1 + rise) for means
        // below d / rise and above most = d + d / rise for the others.
        constexpr double d = 0.1;
        quick_rise_ = kappa * (1.0 - d / (1.0 - d));
        quick_most_ = static_cast<float>(unit_ * std::min(1.0, 0.999 * (d + d / quick_rise_)));
    }

    const WholeTaps& whole_taps_for(std::int64_t largest_sum) {
        if (whole_taps_largest_ != largest_sum) {
            whole_taps_ = whole_taps(across_, largest_sum);
            whole_taps_largest_ = largest_sum;
        }
        return whole_taps_;
    }

    static double smallest_tap(const HalfKernel& kernel) {
        double smallest = kernel[0];
        for (const double tap : kernel) {
            if (tap > 0.0) smallest = std::min(smallest, tap);
        }
        return smallest;
    }

    float* blurred_row(std::int64_t y) { return blurred_rows_.data() + (y % 3) * 2 * plane_; }
    float* level_row(std::int64_t y) { return levels_.data() + (y % window_rows_) * 2 * plane_; }
    std::uint32_t* column_sums(std::int64_t parity) { return column_sums_.data() + parity * (plane_ + 2 * pad_) + pad_; }

    void blur_across(std::int64_t y) {
        float* row = blurred_row(y);
        if (image_.is_narrow) {
            kernels_.blur_across(image_.narrow_row(y), across_taps_, plane_, row, row + plane_);
            for (std::int64_t parity : {even, odd}) {
                std::fill(row + parity * plane_ + num_columns(parity), row + (parity + 1) * plane_, 0.0F);
            }
            return;
        }
        const std::uint32_t* sums = image_.wide_row(y);
        const auto value = [&](std::int64_t x) { return static_cast<float>(static_cast<std::int64_t>(sums[x]) - black_); };
        const auto centre = static_cast<float>(across_[0]), near = static_cast<float>(across_[1]),
                   far = static_cast<float>(across_[2]);
        for (std::int64_t x = 0; x < image_.width; ++x) {
            row[(x % 2) * plane_ + x / 2] =
                far * (value(x - 2) + value(x + 2)) + near * (value(x - 1) + value(x + 1)) + centre * value(x);
        }
    }

    // Row y enters the window and the row that it pushes out leaves; below the image, rows of nothing enter.
    void enter_row(std::int64_t y) {
        const std::int64_t height = image_.height;
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
        step.leaving = y - window_rows_ >= first_ ? level_row(y - window_rows_) : no_levels_.data();
        step.length = plane_;
        step.levels = level_row(y);
        step.even_sums = column_sums(even);
        step.odd_sums = column_sums(odd);
        step.running = running_.data() + pad_;
        step.running_length = plane_ + pad_;
        kernels_.step_window(step);
        if (y < first_) std::fill(column_sums_.begin(), column_sums_.end(), 0U);
        // The published window never reads column 0: every running sum starts behind it.
        if (first_ == 1) std::fill(running_.begin(), running_.begin() + pad_, column_sums(even)[0]);
    }

    std::int64_t num_columns(std::int64_t parity) const { return (image_.width + 1 - parity) / 2; }

    Span span(std::int64_t position, std::int64_t length) const {
        const std::int64_t last = std::min(length - 1, position + after_) + 1;
        return {std::min(std::max(first_, position - before_), last), last};
    }

    void update_areas(std::int64_t num_rows) {
        if (num_rows == inverse_rows_) return;
        inverse_rows_ = num_rows;
        const float scale = 1.0F / static_cast<float>(num_rows);
        const auto quick = static_cast<float>((1.0 + quick_rise_) * (1.0 - 1e-5));
        for (std::size_t i = 0; i < inverse_columns_.size(); ++i) {
            inverse_areas_[i] = inverse_columns_[i] * scale;
            quick_areas_[i] = inverse_areas_[i] * quick;
        }
    }

    void threshold_row(std::int64_t y) {
        const Span rows = span(y, image_.height);
        update_areas(std::max<std::int64_t>(rows.last - rows.first, 1));
        bool has_doubt = false;
        for (std::int64_t parity : {even, odd}) {
            // The window spans start .. stop relative to the even column of the pair.
            const std::int64_t start = parity - before_, stop = parity + after_;
            const auto halved = [](std::int64_t value) { return (value - (value & 1)) / 2; };  // towards minus infinity
            const std::uint32_t* running = running_.data() + pad_;
            ThresholdRow row{};
            row.levels = level_row(y) + parity * plane_;
            row.inverse_areas = inverse_areas_.data() + parity * plane_;
            row.quick_areas = quick_areas_.data() + parity * plane_;
            row.quick_slack = static_cast<float>(4.0 + parameters_.kappa);
            row.quick_most = quick_most_;
            row.pairs_stop = running + halved(stop + 1) - 1;
            row.pairs_start = running + halved(start + 1) - 1;
            row.single_start = (start & 1) != 0 ? column_sums(odd) + halved(start) : nullptr;
            row.single_stop = (stop & 1) == 0 ? column_sums(even) + stop / 2 : nullptr;
            row.num_words = words_;
            row.unit_plus_eps = static_cast<float>(unit_ * (1.0 + parameters_.eps));
            row.kappa = static_cast<float>(parameters_.kappa);
            row.tolerance = tolerance_;
            row.tolerance_slope = tolerance_slope_;
            row.surely_black = surely_black_;
            row.above = bits_.data() + parity * words_;
            row.doubt = doubt_.data() + parity * words_;
            has_doubt |= kernels_.exceed(row);
            const std::int64_t used = num_columns(parity);
            for (std::int64_t word = used / 64; word < words_; ++word) {
                const std::uint64_t inside = word * 64 < used ? (1ULL << (used % 64)) - 1 : 0;
                row.above[word] &= inside;
                row.doubt[word] &= inside;
            }
        }
        if (has_doubt) settle_doubt(y, rows);
    }

    // Decides in double precision what single precision could not.
    void settle_doubt(std::int64_t y, Span rows) {
        const ExactBlur exact = exact_blur();
        for (std::int64_t word = 0; word < 2 * words_; ++word) {
            for (std::uint64_t doubt = doubt_[static_cast<std::size_t>(word)]; doubt != 0; doubt &= doubt - 1) {
                const int bit = __builtin_ctzll(doubt);
                const std::int64_t parity = word / words_, x = 2 * ((word % words_) * 64 + bit) + parity;
                const Span columns = span(x, image_.width);
                const Box window = {static_cast<std::int32_t>(columns.first), static_cast<std::int32_t>(rows.first),
                                    static_cast<std::int32_t>(columns.last), static_cast<std::int32_t>(rows.last)};
                const auto area = static_cast<double>((columns.last - columns.first) * (rows.last - rows.first));
                const double mean = area > 0.0 ? exact.sum_over(window) / area : 0.0;
                const double value = exact.at(x, y), difference = value - mean;
                const double contrast = difference / (1.0 - difference + parameters_.eps);
                const bool is_above = value > mean * (1.0 + parameters_.kappa * (1.0 - contrast)) + rounding;
                const std::uint64_t mask = 1ULL << bit;
                std::uint64_t& bits = bits_[static_cast<std::size_t>(word)];
                bits = is_above ? bits | mask : bits & ~mask;
                ++num_doubtful_;
            }
        }
    }

    void find_blobs() {
        blobs_.start(sizes_.gap_px);
        for (std::int64_t entering = 0; entering < image_.height + after_; ++entering) {
            enter_row(entering);
            if (entering < after_) continue;
            threshold_row(entering - after_);
            blobs_.add_row(bits_.data(), bits_.data() + words_, words_);
        }
    }

    void keep_boxes(std::int32_t left, std::int32_t top) {
        const ExactBlur exact = exact_blur();
        for (const Box& box : blobs_.boxes()) {
            const auto width = static_cast<double>(box.x2 - box.x1);
            const double area = width * static_cast<double>(box.y2 - box.y1);
            if (area < sizes_.min_area_px || area > sizes_.max_area_px || width < sizes_.min_width_px) continue;
            if (!(exact.deviation(box, scratch_) > parameters_.min_deviation + rounding)) continue;
            const std::int32_t f = sizes_.reduction;
            boxes_.push_back({box.x1 * f + left, box.y1 * f + top, box.x2 * f + left, box.y2 * f + top});
        }
        std::sort(boxes_.begin(), boxes_.end(), [](const Box& a, const Box& b) {
            return std::tie(a.y1, a.x1, a.y2, a.x2) < std::tie(b.y1, b.x1, b.y2, b.x2);
        });
    }

    ExactBlur exact_blur() const { return {image_, across_, down_, static_cast<std::int32_t>(black_), static_cast<double>(range_)}; }

    ProposalParameters parameters_;
    Dispatch dispatch_;
    const Kernels& kernels_;
    HalfKernel across_, down_;
    WholeTaps whole_taps_;
    std::int64_t whole_taps_largest_ = -1;

    WorkingSizes sizes_;
    WorkingImage image_;
    std::int64_t black_ = 0, range_ = 1;
    std::int64_t first_ = 0, before_ = 0, after_ = 0, window_rows_ = 0;
    std::int64_t plane_ = 0, words_ = 0, pad_ = 0;
    std::int64_t arranged_width_ = -1;
    double unit_ = 1.0;
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
    std::vector<double> scratch_;
    BlobFinder blobs_;
    std::vector<Box> boxes_;
    std::int64_t num_doubtful_ = 0;
};

ProposalGenerator::ProposalGenerator(const ProposalParameters& parameters, std::optional<Dispatch> dispatch)
    : impl_(std::make_unique<Impl>(parameters, dispatch)) {}
ProposalGenerator::~ProposalGenerator() = default;
ProposalGenerator::ProposalGenerator(ProposalGenerator&&) noexcept = default;
ProposalGenerator& ProposalGenerator::operator=(ProposalGenerator&&) noexcept = default;

const std::vector<Box>& ProposalGenerator::propose(const ImageView& image) { return impl_->propose(image); }
Dispatch ProposalGenerator::dispatch() const { return impl_->dispatch(); }
std::int64_t ProposalGenerator::num_doubtful() const { return impl_->num_doubtful(); }

}  // namespace foreglow
