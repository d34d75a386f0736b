#include "foreglow/proposals.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <tuple>

#include "adaptive_threshold.hpp"
#include "blobs.hpp"
#include "dispatch.hpp"
#include "kernels.hpp"
#include "splitting.hpp"
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
    require(p.split_saddle >= 0.0 && p.split_saddle <= 1.0, "split_saddle: expected 0..1");
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

// Keeps the sums of a block within 32 bits; far beyond any camera.
constexpr std::int32_t max_reduction = 64;

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
          threshold_(parameters_, kernels_) {}

    const std::vector<Box>& propose(const ImageView& frame) {
        boxes_.clear();
        num_doubtful_ = 0;
        const WorkingSizes sizes = working_sizes(parameters_, frame.width_px);
        if (sizes.reduction > max_reduction) {
            throw std::invalid_argument("proposals.reference_width_px: expected frames that are reduced by at most " +
                                        std::to_string(max_reduction) + ", one of " + std::to_string(frame.width_px) +
                                        " columns is reduced by " + std::to_string(sizes.reduction));
        }
        const Box region = considered(frame);
        image_.reduce(cut(frame, region), sizes.reduction, kernels_);
        if (image_.width == 0 || image_.height == 0) return boxes_;
        if (!threshold_.start(image_, sizes.half_window_px)) return boxes_;
        blobs_.start(sizes.gap_px);
        const bool is_split = parameters_.split_saddle > 0.0;
        if (is_split) splitter_.start(image_.width, image_.height);
        for (std::int64_t y = 0; y < image_.height; ++y) {
            const BinaryRow row = threshold_.next_row();
            blobs_.add_row(row.even, row.odd, row.num_words);
            if (is_split) splitter_.add_row(row);
        }
        num_doubtful_ = threshold_.num_doubtful();
        if (is_split) {
            keep_boxes(parts_of(blobs_.boxes(), sizes), sizes, region);
            boxes_.erase(std::unique(boxes_.begin(), boxes_.end(), is_same), boxes_.end());
        } else {
            keep_boxes(blobs_.boxes(), sizes, region);
        }
        return boxes_;
    }

    Dispatch dispatch() const { return dispatch_; }
    std::int64_t num_doubtful() const { return num_doubtful_; }

private:
    // The considered region, cut at the frame's border; looking at nothing, frame after frame, cannot be meant.
    Box considered(const ImageView& frame) const {
        const Box region = parameters_.region.value_or(Box{0, 0, frame.width_px, frame.height_px});
        if (region.x1 >= frame.width_px || region.y1 >= frame.height_px) {
            const auto text = [](std::int32_t value) { return std::to_string(value); };
            throw std::invalid_argument("proposals.region_xyxy_px: expected a part of the frame, [" + text(region.x1) +
                                        ", " + text(region.y1) + ", " + text(region.x2) + ", " + text(region.y2) +
                                        "] lies outside its " + text(frame.width_px) + "x" + text(frame.height_px) +
                                        " px");
        }
        return {region.x1, region.y1, std::min(region.x2, frame.width_px), std::min(region.y2, frame.height_px)};
    }

    static ImageView cut(const ImageView& frame, const Box& region) {
        ImageView view = frame;
        view.width_px = region.x2 - region.x1;
        view.height_px = region.y2 - region.y1;
        view.data = frame.row<char>(region.y1) + std::ptrdiff_t{region.x1} * (frame.pixel_type == PixelType::u8 ? 1 : 2);
        return view;
    }

    static bool is_same(const Box& a, const Box& b) {
        return std::tie(a.x1, a.y1, a.x2, a.y2) == std::tie(b.x1, b.y1, b.x2, b.y2);
    }

    static double area_of(const Box& box) {
        return static_cast<double>(box.x2 - box.x1) * static_cast<double>(box.y2 - box.y1);
    }

    static bool is_too_small(const Box& box, const WorkingSizes& sizes) {
        return area_of(box) < sizes.min_area_px || static_cast<double>(box.x2 - box.x1) < sizes.min_width_px;
    }

    const std::vector<Box>& parts_of(const std::vector<Box>& blobs, const WorkingSizes& sizes) {
        const SplitRule rule{parameters_.split_saddle, sizes.min_area_px, sizes.min_width_px};
        parts_.clear();
        for (const Box& blob : blobs) {
            if (is_too_small(blob, sizes)) continue;  // and so would be its parts
            splitter_.split(blob, image_, threshold_.black(), threshold_.range(), rule, parts_);
        }
        return parts_;
    }

    void keep_boxes(const std::vector<Box>& candidates, const WorkingSizes& sizes, const Box& region) {
        const ExactBlur exact = threshold_.exact();
        for (const Box& box : candidates) {
            if (is_too_small(box, sizes) || area_of(box) > sizes.max_area_px) continue;
            if (!(exact.deviation(box, scratch_) > parameters_.min_deviation + rounding)) continue;
            const std::int32_t f = sizes.reduction;
            boxes_.push_back({box.x1 * f + region.x1, box.y1 * f + region.y1, box.x2 * f + region.x1,
                              box.y2 * f + region.y1});
        }
        std::sort(boxes_.begin(), boxes_.end(), [](const Box& a, const Box& b) {
            return std::tie(a.y1, a.x1, a.y2, a.x2) < std::tie(b.y1, b.x1, b.y2, b.x2);
        });
    }

    ProposalParameters parameters_;
    Dispatch dispatch_;
    const Kernels& kernels_;
    WorkingImage image_;
    AdaptiveThreshold threshold_;
    BlobFinder blobs_;
    BlobSplitter splitter_;
    std::vector<double> scratch_;
    std::vector<Box> boxes_, parts_;
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
