// Where along the road the light of a box may be: all hypotheses weighed, and the quantiles of their ranges.
// The specification, with the equations, is foreglow.distance.weighing (Python).
#pragma once

#include <array>
#include <cstddef>
#include <memory>
#include <optional>
#include <vector>

#include "foreglow/proposals.hpp"

namespace foreglow {

constexpr std::size_t num_features = 3;

// The fields are explained in foreglow.distance.hypotheses.Kind (Python).
struct LightKind {
    std::array<double, num_features> features{}, feature_slopes{};
    double pair_logit = 0.0;
    bool is_lamp = false;
};

// What all kinds share; the fields are explained in foreglow.distance.hypotheses and lamp_pairs (Python).
struct WeighingParameters {
    std::vector<LightKind> kinds;
    std::array<double, num_features> feature_sigmas{};
    std::array<double, 2> box_shares{};
    double reference_log_range = 0.0;
    double spacing_log_sigma = 1.0;
    double pair_share = 0.0, pair_log_sigma = 1.0, pair_log_mean = 0.0;
};

// What is expected of each hypothesis, `num` of them: places along the road times kinds, kinds fastest.
struct Cells {
    std::size_t num = 0;
    const double *azimuths_rad, *elevations_rad, *variances_across, *covariances, *variances_up;
    const double *log_ranges, *log_priors;
};

// What is seen of each box, `num` of them.
struct BoxEvidence {
    std::size_t num = 0;
    const double* directions_rad;   // two a box: to the left, upwards
    const double* sizes_rad;        // two a box: width, height
    const double* features;         // num_features a box
    const double* pair_log_ranges;  // NaN without a partner
};

// Weighs one frame after another. Scratch memory is kept between frames; use one object a thread.
class HypothesisWeigher {
public:
    // Throws std::invalid_argument without a kind, or when this processor lacks `dispatch`.
    explicit HypothesisWeigher(const WeighingParameters& parameters, std::optional<Dispatch> dispatch = std::nullopt);
    ~HypothesisWeigher();
    HypothesisWeigher(HypothesisWeigher&&) noexcept;
    HypothesisWeigher& operator=(HypothesisWeigher&&) noexcept;

    // For each share (ascending or not, between 0 and 1) and box, the log range that so much of the weight lies below:
    // quantiles[share * boxes.num + box]. Throws std::invalid_argument unless the cells are whole places, at least one.
    void quantiles(const Cells& cells, const BoxEvidence& boxes, const std::vector<double>& shares, double* quantiles);

private:
    class Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace foreglow
