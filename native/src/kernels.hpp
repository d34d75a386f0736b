// The inner loops, one table of them for each instruction set: of the proposal stage, and of the ranges (`weigh`).
//
// Rows of the working image are kept as two planes, even and odd columns, so that one multiply-add of 16-bit pairs
// serves the blur and one running sum of pairs serves the window. Column x is element x / 2 of plane x % 2.
#pragma once

#include <cstdint>

namespace foreglow {

// Plane lengths are a multiple of this, so that a mask row is whole 64-bit words and no loop has a remainder.
constexpr std::int64_t plane_quantum = 64;

// Horizontal blur in whole numbers: taps[k] weighs the columns k to the left and right.
struct AcrossTaps {
    std::int16_t taps[3] = {0, 0, 0};
    std::int32_t bias = 0;  // darkest sum times the sum of all taps: taken off, so that it becomes an exact 0
};

// Levels are whole numbers below 2^22 kept as the float `level_zero` + level: the addition rounds, the float's bits
// are the whole number up to a constant, and no conversion is needed either way.
constexpr float level_zero = 8388608.0F;

// A row enters the window of the local mean and another leaves it. Rows of two planes hold the even columns, then,
// `length` further on, the odd ones.
struct WindowStep {
    const float *above, *here, *below;  // rows blurred across
    float outer = 0.0F, centre = 0.0F;  // vertical blur and change of unit: outer * (above + below) + centre * here
    const float* leaving;               // levels; may be the row that `levels` replaces
    std::int64_t length;                // of a plane
    float* levels;                      // out: the levels of the row
    std::uint32_t *even_sums, *odd_sums;  // of the window's rows, column by column
    std::uint32_t* running;               // out: sums of even_sums[j] + odd_sums[j] over j <= i, modulo 2^32 ...
    std::int64_t running_length;          // ... constant beyond `length`
};

// One row of the threshold test. Arrays of two planes hold the even columns, then, `length` further on, the odd ones.
struct ThresholdRow {
    std::int64_t length;         // of a plane
    const float* levels;         // blurred image
    const float* inverse_areas;  // one over the window's number of pixels
    const float* quick_areas;    // the same, times a factor that no pixel above the threshold stays below ...
    float quick_slack, quick_most;  // ... in levels, unless it is above quick_most
    // The window of an even column: running sums of pairs at its end and before its start, and a column at either end
    // that belongs to it without its partner, or nullptr.
    const std::uint32_t *pairs_stop, *pairs_start, *single_start, *single_stop;
    // The window of the odd column next to it: the first column goes, another comes.
    const std::uint32_t *leaving, *entering;
    float unit_plus_eps;  // (1 + eps) in levels
    float kappa;
    float tolerance, tolerance_slope;  // doubt below tolerance + tolerance_slope * mean ...
    float surely_black;                // ... unless the level is at most this
    std::uint64_t* above;              // bit i: the pixel exceeds the threshold; words of the even plane, then the odd
    std::uint64_t* doubt;              // bit i: too close for single precision
};

// Lengths of the arrays of hypotheses are a multiple of this.
constexpr std::int64_t weighing_quantum = 8;

// All hypotheses against one box. The weight of each is
//   N(direction) exp(constant + features . means) (1 - share + share * pair_scale * exp(-off^2 / 2)) exp(logit);
// what has to do with pairs counts where `pair_scale` is not 0.
struct BoxWeighing {
    std::int64_t length;
    const double *azimuths_rad, *elevations_rad, *variances_across, *covariances, *variances_up;
    const double *log_ranges, *constants, *feature_means[3];
    const double *pair_shares, *pair_logits;
    double azimuth_rad, elevation_rad, blur_across, blur_up, features[3];
    double pair_log_range, inverse_spacing_sigma, pair_scale;
    double *weights, *factors;  // out: the weights, to a common factor; and scratch memory
};

struct Kernels {
    // sums[x] = 2 x 2 block sum; widens extremes[0] and extremes[1], the smallest and largest sum so far.
    void (*halve)(const std::uint8_t* upper, const std::uint8_t* lower, std::int64_t num_sums, std::uint16_t* sums,
                  std::uint16_t* extremes);
    // Columns beyond the image's are the caller's to clear; `sums` may be read from -2 to 2 * length + 64.
    void (*blur_across)(const std::uint16_t* sums, const AcrossTaps& taps, std::int64_t length, float* even, float* odd);
    void (*step_window)(const WindowStep& step);
    // Returns whether any pixel is in doubt.
    bool (*exceed)(const ThresholdRow& row);
    void (*weigh)(const BoxWeighing& box);
};

extern const Kernels kernels_baseline;
#if defined(__x86_64__)
extern const Kernels kernels_avx2;
extern const Kernels kernels_avx512;
#endif

}  // namespace foreglow
