// The kernels, written once; each kernels_*.cpp compiles them for one instruction set under the name FOREGLOW_KERNELS.

#include "kernels.hpp"
#include "simd.hpp"

namespace foreglow {
namespace {

void halve(const std::uint8_t* upper, const std::uint8_t* lower, std::int64_t num_sums, std::uint16_t* sums,
           std::uint16_t* extremes) {
    constexpr std::int64_t step = 2 * num_lanes;
    // Sums of four bytes are below 1,021, so that signed comparison serves.
    Shorts lowest = Shorts{} + static_cast<std::int16_t>(32767), highest = Shorts{};
    std::int64_t x = 0;
    for (; x + step <= num_sums; x += step) {
        const Shorts sum = sum_byte_pairs(load<Shorts>(upper + 2 * x)) + sum_byte_pairs(load<Shorts>(lower + 2 * x));
        store(sums + x, sum);
        lowest = smaller(lowest, sum);
        highest = larger(highest, sum);
    }
    if (x > 0) {
        for (int i = 0; i < step; ++i) {
            const auto low = static_cast<std::uint16_t>(lowest[i]), high = static_cast<std::uint16_t>(highest[i]);
            extremes[0] = low < extremes[0] ? low : extremes[0];
            extremes[1] = high > extremes[1] ? high : extremes[1];
        }
    }
    for (; x < num_sums; ++x) {
        const auto sum = static_cast<std::uint16_t>(upper[2 * x] + upper[2 * x + 1] + lower[2 * x] + lower[2 * x + 1]);
        sums[x] = sum;
        extremes[0] = sum < extremes[0] ? sum : extremes[0];
        extremes[1] = sum > extremes[1] ? sum : extremes[1];
    }
}

void blur_across(const std::uint16_t* sums, const AcrossTaps& taps, std::int64_t length, float* even, float* odd) {
    const std::int16_t centre = taps.taps[0], near = taps.taps[1], far = taps.taps[2];
    // Column 2i reads 2i-2 .. 2i+2, column 2i+1 reads 2i-1 .. 2i+3: both lie in the same three pairs.
    const Shorts even_left = splat_pair(far, near), even_mid = splat_pair(centre, near), even_right = splat_pair(far, 0);
    const Shorts odd_left = splat_pair(0, far), odd_mid = splat_pair(near, centre), odd_right = splat_pair(near, far);
    const Ints bias = Ints{} + taps.bias;
    for (std::int64_t i = 0; i < length; i += num_lanes) {
        const auto left = load<Shorts>(sums + 2 * i - 2);
        const auto mid = load<Shorts>(sums + 2 * i);
        const auto right = load<Shorts>(sums + 2 * i + 2);
        store(even + i, to_floats(dot_pairs(left, even_left) + dot_pairs(mid, even_mid) +
                                  (dot_pairs(right, even_right) - bias)));
        store(odd + i, to_floats(dot_pairs(left, odd_left) + dot_pairs(mid, odd_mid) +
                                 (dot_pairs(right, odd_right) - bias)));
    }
}

void blur_down(const float* above, const float* here, const float* below, DownTaps taps, const std::int32_t* leaving,
               std::int64_t length, std::int32_t* levels, std::uint32_t* column_sums) {
    const Floats outer = splat(taps.outer), centre = splat(taps.centre);
    for (std::int64_t i = 0; i < length; i += num_lanes) {
        const Ints level = to_ints(outer * (load<Floats>(above + i) + load<Floats>(below + i)) +
                                   centre * load<Floats>(here + i));
        // `leaving` may be the row that `levels` replaces.
        const auto change = reinterpret_cast<Words>(level - load<Ints>(leaving + i));
        store(levels + i, level);
        store(column_sums + i, load<Words>(column_sums + i) + change);
    }
}

void sum_pairs(const std::uint32_t* even, const std::uint32_t* odd, std::int64_t length, std::uint32_t* running) {
    Words before = Words{};
    for (std::int64_t i = 0; i < length; i += num_lanes) {
        const Words sums = running_sum(load<Words>(even + i) + load<Words>(odd + i)) + before;
        store(running + i, sums);
        before = splat_last(sums);
    }
}

template <bool has_single_start, bool has_single_stop>
bool exceed_plane(const ThresholdRow& row) {
    const Floats unit = splat(row.unit_plus_eps), kappa = splat(row.kappa);
    const Floats tolerance = splat(row.tolerance), slope = splat(row.tolerance_slope);
    std::uint64_t any = 0;
    for (std::int64_t word = 0; word < row.num_words; ++word) {
        std::uint64_t above = 0, doubt = 0;
        for (int part = 0; part < 64; part += num_lanes) {
            const std::int64_t i = word * 64 + part;
            Words sum = load<Words>(row.pairs_stop + i) - load<Words>(row.pairs_start + i);
            if constexpr (has_single_start) sum += load<Words>(row.single_start + i);
            if constexpr (has_single_stop) sum += load<Words>(row.single_stop + i);
            const Floats mean = to_floats(reinterpret_cast<Ints>(sum)) * load<Floats>(row.inverse_areas + i);
            // I > T without a division, D = I - mean: D (1 + eps - D) > kappa mean (1 + eps - 2 D).
            const Floats difference = to_floats(load<Ints>(row.levels + i)) - mean;
            const Floats rest = unit - difference;
            const Floats excess = difference * rest - kappa * mean * (rest - difference);
            above |= greater_mask(excess, Floats{}) << part;
            doubt |= greater_mask(tolerance + slope * mean, magnitude(excess)) << part;
        }
        row.above[word] = above;
        row.doubt[word] = doubt;
        any |= doubt;
    }
    return any != 0;
}

bool exceed(const ThresholdRow& row) {
    if (row.single_start != nullptr) {
        return row.single_stop != nullptr ? exceed_plane<true, true>(row) : exceed_plane<true, false>(row);
    }
    return row.single_stop != nullptr ? exceed_plane<false, true>(row) : exceed_plane<false, false>(row);
}

}  // namespace

extern const Kernels FOREGLOW_KERNELS;
const Kernels FOREGLOW_KERNELS = {halve, blur_across, blur_down, sum_pairs, exceed};

}  // namespace foreglow
