#include "foreglow/hypotheses.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>

#include "aligned.hpp"
#include "dispatch.hpp"

namespace foreglow {

namespace {

using Column = AlignedVector<double>;

// What does not depend on the box, as `BoxWeighing` has it, by rising range.
struct SortedCells {
    std::size_t num = 0;
    Column azimuths_rad, elevations_rad, variances_across, covariances, variances_up, log_ranges, constants;
    Column feature_means[num_features], pair_shares, pair_logits;
};

}  // namespace

class HypothesisWeigher::Impl {
public:
    Impl(const HypothesisParameters& parameters, Dispatch dispatch)
        : parameters_(parameters), kernels_(kernels_for(dispatch)) {
        if (parameters.kinds.empty()) throw std::invalid_argument("kinds: expected at least one");
    }

    void quantiles(const Cells& cells, const BoxEvidence& boxes, const std::vector<double>& shares, double* quantiles) {
        if (cells.num == 0 || cells.num % parameters_.kinds.size() != 0) {
            throw std::invalid_argument("cells: expected whole places of all kinds, at least one");
        }
        if (boxes.num == 0) return;
        sort(cells);
        fill(cells);
        BoxWeighing weighing = weighing_of_frame();
        for (std::size_t box = 0; box < boxes.num; ++box) {
            set_box(boxes, box, weighing);
            kernels_.weigh(weighing);
            sum_up();
            for (std::size_t i = 0; i < shares.size(); ++i) quantiles[i * boxes.num + box] = quantile(shares[i]);
        }
    }

    const HypothesisParameters& parameters() const { return parameters_; }

private:
    // By insertion: along the road the ranges nearly rise. Equal ones keep their order.
    void sort(const Cells& cells) {
        order_.resize(cells.num);
        for (std::size_t i = 0; i < cells.num; ++i) {
            const double log_range = cells.log_ranges[i];
            std::size_t place = i;
            for (; place > 0 && cells.log_ranges[order_[place - 1]] > log_range; --place) {
                order_[place] = order_[place - 1];
            }
            order_[place] = static_cast<std::uint32_t>(i);
        }
    }

    void fill(const Cells& cells) {
        sorted_.num = cells.num;
        constexpr auto quantum = static_cast<std::size_t>(weighing_quantum);
        const std::size_t length = (cells.num + quantum - 1) / quantum * quantum;
        const auto gather = [&](const double* values, Column& column, double beyond) {
            column.assign(length, beyond);
            for (std::size_t i = 0; i < cells.num; ++i) column[i] = values[order_[i]];
        };
        gather(cells.azimuths_rad, sorted_.azimuths_rad, 0.0);
        gather(cells.elevations_rad, sorted_.elevations_rad, 0.0);
        gather(cells.variances_across, sorted_.variances_across, 1.0);
        gather(cells.covariances, sorted_.covariances, 0.0);
        gather(cells.variances_up, sorted_.variances_up, 1.0);
        gather(cells.log_ranges, sorted_.log_ranges, 0.0);
        gather(cells.log_priors, sorted_.constants, std::numeric_limits<double>::lowest());
        for (Column& means : sorted_.feature_means) means.assign(length, 0.0);
        sorted_.pair_shares.assign(length, 0.0);
        sorted_.pair_logits.assign(length, 0.0);
        for (Column* scratch : {&weights_, &factors_, &ends_}) scratch->resize(length);
        no_partner_.resize(parameters_.kinds.size());
        for (std::size_t kind = 0; kind < no_partner_.size(); ++kind) {
            no_partner_[kind] = -std::log1p(std::exp(parameters_.kinds[kind].pair_logit));
        }
        for (std::size_t i = 0; i < cells.num; ++i) {
            const std::size_t number = order_[i] % parameters_.kinds.size();
            const LightKind& kind = parameters_.kinds[number];
            const double log_range = sorted_.log_ranges[i] - parameters_.reference_log_range;
            sorted_.constants[i] += no_partner_[number];
            // Gaussian features with the same variance for all kinds: what is left is linear in them.
            for (std::size_t k = 0; k < num_features; ++k) {
                const double mean =
                    (kind.features[k] + kind.feature_slopes[k] * log_range) / parameters_.feature_sigmas[k];
                sorted_.feature_means[k][i] = mean;
                sorted_.constants[i] -= 0.5 * mean * mean;
            }
            sorted_.pair_shares[i] = kind.is_lamp ? parameters_.pair_share : 0.0;
            sorted_.pair_logits[i] = kind.pair_logit;
        }
    }

    BoxWeighing weighing_of_frame() {
        BoxWeighing weighing{};
        weighing.length = static_cast<std::int64_t>(weights_.size());
        weighing.azimuths_rad = sorted_.azimuths_rad.data();
        weighing.elevations_rad = sorted_.elevations_rad.data();
        weighing.variances_across = sorted_.variances_across.data();
        weighing.covariances = sorted_.covariances.data();
        weighing.variances_up = sorted_.variances_up.data();
        weighing.log_ranges = sorted_.log_ranges.data();
        weighing.constants = sorted_.constants.data();
        for (std::size_t k = 0; k < num_features; ++k) weighing.feature_means[k] = sorted_.feature_means[k].data();
        weighing.pair_shares = sorted_.pair_shares.data();
        weighing.pair_logits = sorted_.pair_logits.data();
        weighing.inverse_spacing_sigma = 1.0 / parameters_.spacing_log_sigma;
        weighing.weights = weights_.data();
        weighing.factors = factors_.data();
        return weighing;
    }

    void set_box(const BoxEvidence& boxes, std::size_t box, BoxWeighing& weighing) const {
        const auto squared = [](double value) { return value * value; };
        weighing.azimuth_rad = boxes.directions_rad[2 * box];
        weighing.elevation_rad = boxes.directions_rad[2 * box + 1];
        weighing.blur_across = squared(boxes.sizes_rad[2 * box] * parameters_.box_shares[0]);
        weighing.blur_up = squared(boxes.sizes_rad[2 * box + 1] * parameters_.box_shares[1]);
        for (std::size_t k = 0; k < num_features; ++k) {
            weighing.features[k] = boxes.features[num_features * box + k] / parameters_.feature_sigmas[k];
        }
        const double seen = boxes.pair_log_ranges[box];
        weighing.pair_log_range = seen;
        weighing.pair_scale = 0.0;
        if (!std::isnan(seen)) {
            const double off = (seen - parameters_.pair_log_mean) / parameters_.pair_log_sigma;
            weighing.pair_scale =
                std::exp(0.5 * off * off) * parameters_.pair_log_sigma / parameters_.spacing_log_sigma;
        }
    }

    // ends_[i] is the weight of all cells up to i. By fours, of which only the last sum waits for those before.
    void sum_up() {
        static_assert(weighing_quantum % 4 == 0);
        double before = 0.0;
        for (std::size_t i = 0; i < weights_.size(); i += 4) {
            const double one = weights_[i], two = one + weights_[i + 1];
            const double three = two + weights_[i + 2], four = three + weights_[i + 3];
            ends_[i] = before + one;
            ends_[i + 1] = before + two;
            ends_[i + 2] = before + three;
            ends_[i + 3] = before += four;
        }
    }

    // Every value stands for the middle of its weight; between two of them it is linear.
    double quantile(double share) const {
        if (sorted_.num == 1) return sorted_.log_ranges[0];
        const auto middle = [this](std::size_t i) { return ends_[i] - 0.5 * weights_[i]; };
        const double wanted = share * ends_[sorted_.num - 1];
        std::size_t after = 1, last = sorted_.num - 1;
        while (after < last) {
            const std::size_t half = (after + last) / 2;
            if (middle(half) < wanted) {
                after = half + 1;
            } else {
                last = half;
            }
        }
        const double low = middle(after - 1), gap = middle(after) - low;
        const double between = gap > 0.0 ? std::min(std::max((wanted - low) / gap, 0.0), 1.0) : 0.0;
        const double from = sorted_.log_ranges[after - 1], to = sorted_.log_ranges[after];
        return from + between * (to - from);
    }

    HypothesisParameters parameters_;
    const Kernels& kernels_;
    std::vector<std::uint32_t> order_;
    std::vector<double> no_partner_;
    SortedCells sorted_;
    Column weights_, factors_, ends_;
};

HypothesisWeigher::HypothesisWeigher(const HypothesisParameters& parameters, std::optional<Dispatch> dispatch)
    : impl_(std::make_unique<Impl>(parameters, dispatch.value_or(available_dispatch().back()))) {}
HypothesisWeigher::~HypothesisWeigher() = default;
HypothesisWeigher::HypothesisWeigher(HypothesisWeigher&&) noexcept = default;
HypothesisWeigher& HypothesisWeigher::operator=(HypothesisWeigher&&) noexcept = default;

const HypothesisParameters& HypothesisWeigher::parameters() const { return impl_->parameters(); }

void HypothesisWeigher::quantiles(const Cells& cells, const BoxEvidence& boxes, const std::vector<double>& shares,
                                  double* quantiles) {
    impl_->quantiles(cells, boxes, shares, quantiles);
}

}  // namespace foreglow
