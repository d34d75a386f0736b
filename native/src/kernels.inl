// The kernels, written once; each kernels_*.cpp compiles them for one instruction set under the name FOREGLOW_KERNELS.

#include "kernels.hpp"
#include "simd.hpp"
#include "weighing.inl"

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
    const Ints bias = Ints{} - taps.bias;
    for (std::int64_t i = 0; i < length; i += num_lanes) {
        const auto left = load<Shorts>(sums + 2 * i - 2);
        const auto mid = load<Shorts>(sums + 2 * i);
        const auto right = load<Shorts>(sums + 2 * i + 2);
        store(even + i, to_floats(add_dot_pairs(
                            add_dot_pairs(add_dot_pairs(bias, left, even_left), mid, even_mid), right, even_right)));
        store(odd + i, to_floats(add_dot_pairs(
                           add_dot_pairs(add_dot_pairs(bias, left, odd_left), mid, odd_mid), right, odd_right)));
    }
}

// Writes the levels of plane `parity` from element i on, and returns the moved column sums.
inline Words step_plane(const WindowStep& step, std::int64_t parity, std::int64_t i, std::uint32_t* sums) {
    const std::int64_t at = parity * step.length + i;
    const Floats outer = splat(step.outer), centre = splat(step.centre), zero = splat(level_zero);
    const Floats level = outer * (load<Floats>(step.above + at) + load<Floats>(step.below + at)) +
                         (centre * load<Floats>(step.here + at) + zero);
    // The constant in the levels' bits cancels.
    const Words moved = load<Words>(sums + i) + (reinterpret_cast<Words>(level) - load<Words>(step.leaving + at));
    store(step.levels + at, level);
    store(sums + i, moved);
    return moved;
}

void step_window(const WindowStep& arguments) {
    const WindowStep step = arguments;  // a copy that no store through a pointer can be thought to change
    Words before = Words{};
    std::int64_t i = 0;
    for (; i < step.length; i += num_lanes) {
        const Words even = step_plane(step, 0, i, step.even_sums);
        const Words sums = running_sum(even + step_plane(step, 1, i, step.odd_sums));
        store(step.running + i, sums + before);
        before += splat_last(sums);
    }
    for (; i < step.running_length; i += num_lanes) store(step.running + i, before);
}

// Sums over the windows of the even columns from element i on, and of the odd ones.
template <bool has_single_start, bool has_single_stop>
inline void sum_windows(const ThresholdRow& row, std::int64_t i, Floats totals[2]) {
    Words sum = load<Words>(row.pairs_stop + i) - load<Words>(row.pairs_start + i);
    if constexpr (has_single_start) sum += load<Words>(row.single_start + i);
    if constexpr (has_single_stop) sum += load<Words>(row.single_stop + i);
    totals[0] = to_floats(reinterpret_cast<Ints>(sum));
    totals[1] = to_floats(reinterpret_cast<Ints>(sum - load<Words>(row.leaving + i) + load<Words>(row.entering + i)));
}

template <bool has_single_start, bool has_single_stop>
bool exceed_row(const ThresholdRow& arguments) {
    const ThresholdRow row = arguments;  // a copy that no store through a pointer can be thought to change
    const Floats unit = splat(row.unit_plus_eps), kappa = splat(row.kappa), zero = splat(level_zero);
    const Floats tolerance_zero = splat(row.tolerance), slope = splat(row.tolerance_slope);
    const Floats quick_slack = splat(level_zero - row.quick_slack), quick_most = splat(level_zero + row.quick_most);
    const Floats surely_black = splat(row.surely_black);
    const std::int64_t num_words = row.length / 64;
    std::uint64_t any = 0;
    for (std::int64_t word = 0; word < num_words; ++word) {
        std::uint64_t candidates[2] = {0, 0};
        for (int part = 0; part < 64; part += num_lanes) {
            const std::int64_t i = word * 64 + part;
            Floats totals[2];
            sum_windows<has_single_start, has_single_stop>(row, i, totals);
            for (int parity = 0; parity < 2; ++parity) {
                const std::int64_t at = parity * row.length + i;
                const Floats least = smaller(totals[parity] * load<Floats>(row.quick_areas + at) + quick_slack, quick_most);
                candidates[parity] |= greater_mask(load<Floats>(row.levels + at), least) << part;
            }
        }
        for (int parity = 0; parity < 2; ++parity) {
            std::uint64_t above = 0, doubt = 0;
            while (candidates[parity] != 0) {  // hardly ever, at night
                const int part = __builtin_ctzll(candidates[parity]) / num_lanes * num_lanes;
                candidates[parity] &= ~(((1ULL << num_lanes) - 1) << part);
                const std::int64_t i = word * 64 + part, at = parity * row.length + i;
                Floats totals[2];
                sum_windows<has_single_start, has_single_stop>(row, i, totals);
                const Floats mean = totals[parity] * load<Floats>(row.inverse_areas + at);
                const Floats value = load<Floats>(row.levels + at) - zero;
                // I > T without a division, D = I - mean: D (1 + eps - D) > kappa mean (1 + eps - 2 D).
                const Floats difference = value - mean;
                const Floats rest = unit - difference;
                const Floats excess = difference * rest - kappa * mean * (rest - difference);
                const Floats tolerance = tolerance_zero + slope * mean;
                above |= greater_mask(excess, Floats{}) << part;
                doubt |= (greater_mask(tolerance, magnitude(excess)) & greater_mask(value, surely_black)) << part;
            }
            row.above[parity * num_words + word] = above;
            row.doubt[parity * num_words + word] = doubt;
            any |= doubt;
        }
    }
    return any != 0;
}

bool exceed(const ThresholdRow& row) {
    if (row.single_start != nullptr) {
        return row.single_stop != nullptr ? exceed_row<true, true>(row) : exceed_row<true, false>(row);
    }
    return row.single_stop != nullptr ? exceed_row<false, true>(row) : exceed_row<false, false>(row);
}

}  // namespace

extern const Kernels FOREGLOW_KERNELS;
const Kernels FOREGLOW_KERNELS = {halve, blur_across, step_window, exceed, weigh};

}  // namespace foreglow
