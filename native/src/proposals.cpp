#include "foreglow/proposals.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <tuple>

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
        prepare();
        find_blobs();
        keep_boxes(left, top);
        return boxes_;
    }

    Dispatch dispatch() const { return dispatch_; }
    std::int64_t num_doubtful() const { return num_doubtful_; }

private:
    static constexpr std::int64_t even = 0, odd = 1;

    // Layout, units and tolerances for the current image; allocates only where sizes grow.
    void prepare() {
        const bool is_published = parameters_.window == Window::published;
        first_ = is_published ? 1 : 0;
        before_ = is_published ? sizes_.half_window_px - 1 : sizes_.half_window_px;
        after_ = sizes_.half_window_px;
        window_rows_ = before_ + after_ + 1;

        plane_ = ((image_.width + 1) / 2 + plane_quantum - 1) / plane_quantum * plane_quantum;
        words_ = plane_ / 64;
        pad_ = (sizes_.half_window_px / 2 + 2 + plane_quantum - 1) / plane_quantum * plane_quantum;
        const auto fill = [](auto& values, std::int64_t size) {
            values.assign(static_cast<std::size_t>(size), 0);
        };
        levels_.resize(static_cast<std::size_t>(window_rows_ * 2 * plane_));
        blurred_rows_.resize(static_cast<std::size_t>(3 * 2 * plane_));
        fill(no_levels_, 2 * plane_);
        fill(column_sums_, 2 * (plane_ + 2 * pad_));
        fill(running_, plane_ + 2 * pad_);
        inverse_areas_.resize(static_cast<std::size_t>(2 * plane_));
        inverse_rows_ = 0;
        fill(bits_, 2 * words_);
        fill(doubt_, 2 * words_);

        // Levels are as fine as 32-bit sums over a window and 24-bit floats allow.
        const auto area = static_cast<double>(window_rows_ * window_rows_);
        unit_ = std::exp2(std::min(22.0, std::floor(std::log2(2147483647.0 / area) - 1e-3)));
        double blur_error = 1e-6;
        if (image_.is_narrow) {
            const WholeTaps whole = whole_taps_for(image_.full_scale);
            std::copy(whole.taps.begin(), whole.taps.end(), across_taps_.taps);
            across_taps_.bias = static_cast<std::int32_t>(black_ * whole.sum);
            across_sum_ = whole.sum;
            blur_error += whole.relative_error;
        } else {
            across_sum_ = 1.0;
        }
        const double to_levels = unit_ / (across_sum_ * static_cast<double>(range_));
        down_taps_ = {static_cast<float>(down_[1] * to_levels), static_cast<float>(down_[0] * to_levels)};

        // How far single precision can move D (1 + eps - D) - kappa mean (1 + eps - 2 D) near its zero, where
        // I <= (1 + kappa) mean: I and the mean are off by one level each, and by blur_error of themselves.
        const double kappa = parameters_.kappa;
        tolerance_ = static_cast<float>(1.5 * unit_ * (2.0 + 5.0 * kappa));
        tolerance_slope_ = static_cast<float>(
            1.5 * unit_ * (((1.0 + 2.0 * kappa) * (1.0 + kappa) + 1.0 + 3.0 * kappa) * blur_error + 3e-7 * (1.0 + 2.0 * kappa)));
    }

    const WholeTaps& whole_taps_for(std::int64_t largest_sum) {
        if (whole_taps_largest_ != largest_sum) {
            whole_taps_ = whole_taps(across_, largest_sum);
            whole_taps_largest_ = largest_sum;
        }
        return whole_taps_;
    }

    float* blurred_row(std::int64_t y) { return blurred_rows_.data() + (y % 3) * 2 * plane_; }
    std::int32_t* level_row(std::int64_t y) { return levels_.data() + (y % window_rows_) * 2 * plane_; }
    std::uint32_t* column_sums(std::int64_t parity) { return column_sums_.data() + parity * (plane_ + 2 * pad_) + pad_; }

    void blur_across(std::int64_t y) {
        float* row = blurred_row(y);
        if (image_.is_narrow) {
            kernels_.blur_across(image_.narrow_row(y), across_taps_, plane_, row, row + plane_);
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

    // Levels of row y enter the window, those that it pushes out leave.
    void enter_row(std::int64_t y) {
        if (y == 0) blur_across(0);
        if (y + 1 < image_.height) blur_across(y + 1);
        const float* above = blurred_row(mirrored(y - 1, image_.height));
        const float* below = blurred_row(mirrored(y + 1, image_.height));
        const std::int64_t left = y - window_rows_;
        const std::int32_t* leaving = left >= first_ ? level_row(left) : no_levels_.data();
        for (std::int64_t parity : {even, odd}) {
            const std::int64_t offset = parity * plane_;
            kernels_.blur_down(above + offset, blurred_row(y) + offset, below + offset, down_taps_, leaving + offset,
                               plane_, level_row(y) + offset, column_sums(parity));
        }
        if (y < first_) std::fill(column_sums_.begin(), column_sums_.end(), 0U);
        trim_column_sums();
    }

    void leave_row(std::int64_t y) {
        for (std::int64_t parity : {even, odd}) {
            const std::int32_t* leaving = level_row(y) + parity * plane_;
            std::uint32_t* sums = column_sums(parity);
            for (std::int64_t i = 0; i < plane_; ++i) sums[i] -= static_cast<std::uint32_t>(leaving[i]);
        }
        trim_column_sums();
    }

    // Columns that no window reads: those beyond the image, and column 0 of the published window.
    void trim_column_sums() {
        for (std::int64_t parity : {even, odd}) {
            const std::int64_t used = (image_.width + 1 - parity) / 2;
            std::fill(column_sums(parity) + used, column_sums(parity) + plane_, 0U);
        }
        if (first_ == 1) column_sums(even)[0] = 0;
    }

    Span span(std::int64_t position, std::int64_t length) const {
        const std::int64_t last = std::min(length - 1, position + after_) + 1;
        return {std::min(std::max(first_, position - before_), last), last};
    }

    void update_inverse_areas(std::int64_t num_rows) {
        if (num_rows == inverse_rows_) return;
        inverse_rows_ = num_rows;
        for (std::int64_t x = 0; x < image_.width; ++x) {
            const Span columns = span(x, image_.width);
            const std::int64_t area = std::max<std::int64_t>((columns.last - columns.first) * num_rows, 1);
            inverse_areas_[static_cast<std::size_t>((x % 2) * plane_ + x / 2)] = static_cast<float>(1.0 / static_cast<double>(area));
        }
    }

    void threshold_row(std::int64_t y) {
        const Span rows = span(y, image_.height);
        update_inverse_areas(std::max<std::int64_t>(rows.last - rows.first, 1));
        kernels_.sum_pairs(column_sums(even), column_sums(odd), plane_ + pad_, running_.data() + pad_);
        bool has_doubt = false;
        for (std::int64_t parity : {even, odd}) {
            // The window spans start .. stop relative to the even column of the pair.
            const std::int64_t start = parity - before_, stop = parity + after_;
            const auto halved = [](std::int64_t value) { return (value - (value & 1)) / 2; };  // towards minus infinity
            const std::uint32_t* running = running_.data() + pad_;
            ThresholdRow row{};
            row.levels = level_row(y) + parity * plane_;
            row.inverse_areas = inverse_areas_.data() + parity * plane_;
            row.pairs_stop = running + halved(stop + 1) - 1;
            row.pairs_start = running + halved(start + 1) - 1;
            row.single_start = (start & 1) != 0 ? column_sums(odd) + halved(start) : nullptr;
            row.single_stop = (stop & 1) == 0 ? column_sums(even) + stop / 2 : nullptr;
            row.num_words = words_;
            row.unit_plus_eps = static_cast<float>(unit_ * (1.0 + parameters_.eps));
            row.kappa = static_cast<float>(parameters_.kappa);
            row.tolerance = tolerance_;
            row.tolerance_slope = tolerance_slope_;
            row.above = bits_.data() + parity * words_;
            row.doubt = doubt_.data() + parity * words_;
            has_doubt |= kernels_.exceed(row);
            const std::int64_t used = (image_.width + 1 - parity) / 2;
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
                const bool is_above = value > mean * (1.0 + parameters_.kappa * (1.0 - contrast));
                const std::uint64_t mask = 1ULL << bit;
                std::uint64_t& bits = bits_[static_cast<std::size_t>(word)];
                bits = is_above ? bits | mask : bits & ~mask;
                ++num_doubtful_;
            }
        }
    }

    void find_blobs() {
        blobs_.start(sizes_.gap_px);
        std::int64_t entered = 0;
        for (std::int64_t y = 0; y < image_.height; ++y) {
            const std::int64_t last = std::min(image_.height - 1, y + after_);
            if (y + after_ > image_.height - 1 && y - before_ - 1 >= first_) leave_row(y - before_ - 1);
            for (; entered <= last; ++entered) enter_row(entered);
            threshold_row(y);
            blobs_.add_row(bits_.data(), bits_.data() + words_, words_);
        }
    }

    void keep_boxes(std::int32_t left, std::int32_t top) {
        const ExactBlur exact = exact_blur();
        for (const Box& box : blobs_.boxes()) {
            const auto width = static_cast<double>(box.x2 - box.x1);
            const double area = width * static_cast<double>(box.y2 - box.y1);
            if (area < sizes_.min_area_px || area > sizes_.max_area_px || width < sizes_.min_width_px) continue;
            if (!(exact.deviation(box, scratch_) > parameters_.min_deviation)) continue;
            const std::int32_t f = sizes_.reduction;
            boxes_.push_back({box.x1 * f + left, box.y1 * f + top, box.x2 * f + left, box.y2 * f + top});
        }
        std::sort(boxes_.begin(), boxes_.end(), [](const Box& a, const Box& b) {
            return std::tie(a.y1, a.x1, a.y2, a.x2) < std::tie(b.y1, b.x1, b.y2, b.x2);
        });
    }

    ExactBlur exact_blur() const { return {image_, across_, down_, black_, static_cast<double>(range_)}; }

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
    double unit_ = 1.0, across_sum_ = 1.0;
    AcrossTaps across_taps_;
    DownTaps down_taps_;
    float tolerance_ = 0.0F, tolerance_slope_ = 0.0F;

    std::vector<float> blurred_rows_;          // three rows, blurred across
    std::vector<std::int32_t> levels_;         // the window's rows, blurred, in a ring
    std::vector<std::int32_t> no_levels_;
    std::vector<std::uint32_t> column_sums_;   // of the window's rows
    std::vector<std::uint32_t> running_;       // of column_sums_, in pairs
    std::vector<float> inverse_areas_;
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
