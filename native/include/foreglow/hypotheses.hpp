// Where along the road the light of a box may be: all hypotheses, their weights, and the quantiles of their ranges.
// The specification, with the equations, is foreglow.distance.hypotheses and weighing (Python).
#pragma once

#include <array>
#include <cstddef>
#include <memory>
#include <optional>
#include <vector>

#include "foreglow/dispatch.hpp"

namespace foreglow {

constexpr std::size_t num_features = 3;

// The fields are explained in foreglow.distance.hypotheses.Kind (Python).
struct LightKind {
    double side = 0.0, offset_m = 0.0, height_m = 0.0, offset_sigma_m = 1.0, height_sigma_m = 1.0;
    bool is_lamp = false, is_anywhere = false;
    double log_share = 0.0, log_range = 0.0;
    std::array<double, num_features> features{}, feature_slopes{};
    double pair_logit = 0.0;
};

// What all kinds share; the fields are explained in foreglow.distance.hypotheses and lamp_pairs (Python).
struct HypothesisParameters {
    std::vector<LightKind> kinds;
    std::vector<double> places_m, cell_sigmas_m, log_cells;  // of the places along the road
    double range_log_sigma = 1.0, pixel_sigma_rad = 0.0, slope_sigma = 0.0;
    double anywhere_sigma_rad = 0.0, plane_sigma_rad = 0.0, roll_sigma_rad = 0.0, impossible = 0.0;
    std::array<double, num_features> feature_sigmas{};
    std::array<double, 2> box_shares{};
    double reference_log_range = 0.0;
    double spacing_log_sigma = 1.0;
    double pair_share = 0.0, pair_log_sigma = 1.0, pair_log_mean = 0.0;
};

// The road before us at all places; the fields are explained in foreglow.distance.ribbon.Ribbon (Python).
struct Ribbon {
    const double *x_m, *y_m, *z_m, *cos, *sin, *slope, *banking, *crown;
    const bool* is_known;
    double half_width_m, lean, rise_m, curvature_per_m, start_cos, start_sin, start_slope;
    double shift_sigma_m, yaw_sigma_rad, left_sigma_m;
};

// What is expected of each hypothesis, `num` of them: places along the road times kinds, kinds fastest.
struct Cells {
    std::size_t num = 0;
    const double *azimuths_rad, *elevations_rad, *variances_across, *covariances, *variances_up;
    const double *log_ranges, *log_priors;
};

// Writes the cells along `road`, or those of no road, to seven `columns` one after another, in the order of `Cells`.
void cells_along(const HypothesisParameters& parameters, const Ribbon* road, const std::array<double, 3>& camera_m,
                 double pitch_sigma_rad, double* columns);

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
    explicit HypothesisWeigher(const HypothesisParameters& parameters, std::optional<Dispatch> dispatch = std::nullopt);
    ~HypothesisWeigher();
    HypothesisWeigher(HypothesisWeigher&&) noexcept;
    HypothesisWeigher& operator=(HypothesisWeigher&&) noexcept;

    const HypothesisParameters& parameters() const;

    // For each share (ascending or not, between 0 and 1) and box, the log range that so much of the weight lies below:
    // quantiles[share * boxes.num + box]. Throws std::invalid_argument unless the cells are whole places, at least one.
    void quantiles(const Cells& cells, const BoxEvidence& boxes, const std::vector<double>& shares, double* quantiles);

private:
    class Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace foreglow
