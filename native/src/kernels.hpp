// The inner loops of the proposal stage, one table of them for each instruction set.
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

// Vertical blur and change of unit: level = outer * (above + below) + centre * here.
struct DownTaps {
    float outer = 0.0F, centre = 0.0F;
};

// One plane of one row of the threshold test.
struct ThresholdRow {
    const std::int32_t* levels;         // blurred image, this plane
    const float* inverse_areas;         // one over the window's number of pixels, this plane
    const std::uint32_t* pairs_stop;    // running sums of pairs at the window's end ...
    const std::uint32_t* pairs_start;   // ... and before its start
    const std::uint32_t* single_start;  // a column that belongs to the window without its partner, or nullptr
    const std::uint32_t* single_stop;
    std::int64_t num_words;
    float unit_plus_eps;  // (1 + eps) in levels
    float kappa;
    float tolerance, tolerance_slope;  // doubt below tolerance + tolerance_slope * mean
    std::uint64_t* above;              // bit i: the pixel exceeds the threshold
    std::uint64_t* doubt;              // bit i: too close for single precision
};

struct Kernels {
    // sums[x] = 2 x 2 block sum; widens extremes[0] and extremes[1], the smallest and largest sum so far.
    void (*halve)(const std::uint8_t* upper, const std::uint8_t* lower, std::int64_t num_sums, std::uint16_t* sums,
                  std::uint16_t* extremes);
    // `sums` may be read from -2 to 2 * length + 64.
    void (*blur_across)(const std::uint16_t* sums, const AcrossTaps& taps, std::int64_t length, float* even, float* odd);
    // Writes the levels of a row and moves the window's column sums on: in with them, out with `leaving`.
    void (*blur_down)(const float* above, const float* here, const float* below, DownTaps taps,
                      const std::int32_t* leaving, std::int64_t length, std::int32_t* levels,
                      std::uint32_t* column_sums);
    // running[i] = sum of even[j] + odd[j] over j <= i, modulo 2^32.
    void (*sum_pairs)(const std::uint32_t* even, const std::uint32_t* odd, std::int64_t length,
                      std::uint32_t* running);
    // Returns whether any pixel is in doubt.
    bool (*exceed)(const ThresholdRow& row);
};

extern const Kernels kernels_baseline;
#if defined(__x86_64__)
extern const Kernels kernels_avx2;
extern const Kernels kernels_avx512;
#endif

}  // namespace foreglow
