// The weights of all hypotheses for one box, in double precision. Part of kernels.inl.

namespace foreglow {
namespace {

// e^x for x <= 0, to 1e-11; what is less than e^-700 counts as that.
inline Doubles exponential(Doubles x) {
    constexpr double to_integer = 6755399441055744.0;  // 1.5 * 2^52: what is added to it is rounded to a whole number
    constexpr double inverse_factorials[] = {1.0 / 362880, 1.0 / 40320, 1.0 / 5040, 1.0 / 720, 1.0 / 120,
                                             1.0 / 24,     1.0 / 6,     0.5,        1.0,       1.0};
    x = x > -700.0 ? x : Doubles{} - 700.0;
    const Doubles shifted = x * 1.4426950408889634 + to_integer;
    const Doubles rest = x - (shifted - to_integer) * 0.6931471805599453;
    Doubles power = Doubles{} + inverse_factorials[0];
    for (int i = 1; i < 10; ++i) power = power * rest + inverse_factorials[i];
    // The low bits of `shifted` are the power of two: it goes into the exponent.
    return reinterpret_cast<Doubles>(reinterpret_cast<Longs>(power) + (reinterpret_cast<Longs>(shifted) << 52));
}

// Exponents go to `weights`, what they are multiplied with to `factors`; returns the largest exponent.
template <bool has_partner>
double exponents(const BoxWeighing& box) {
    Doubles largest = Doubles{} - 1e300;
    for (std::int64_t i = 0; i < box.length; i += num_lanes / 2) {
        const auto of = [i](const double* column) { return load<Doubles>(column + i); };
        const Doubles across = of(box.variances_across) + box.blur_across, up = of(box.variances_up) + box.blur_up;
        const Doubles left = box.azimuth_rad - of(box.azimuths_rad), above = box.elevation_rad - of(box.elevations_rad);
        const Doubles tilted = of(box.covariances);
        const Doubles inverse = 1.0 / (across * up - tilted * tilted);
        const Doubles squares = up * left * left - 2.0 * tilted * left * above + across * above * above;
        Doubles exponent = of(box.constants) - 0.5 * squares * inverse;
        for (int k = 0; k < 3; ++k) exponent += box.features[k] * of(box.feature_means[k]);
        Doubles factor = square_root(inverse);
        if (has_partner) {
            const Doubles off = (of(box.log_ranges) - box.pair_log_range) * box.inverse_spacing_sigma;
            const Doubles share = of(box.pair_shares);
            factor *= share * box.pair_scale * exponential(-0.5 * off * off) + (1.0 - share);
            exponent += of(box.pair_logits);
        }
        largest = exponent > largest ? exponent : largest;
        store(box.weights + i, exponent);
        store(box.factors + i, factor);
    }
    double most = largest[0];
    for (int lane = 1; lane < num_lanes / 2; ++lane) most = largest[lane] > most ? largest[lane] : most;
    return most;
}

void weigh(const BoxWeighing& arguments) {
    const BoxWeighing box = arguments;  // a copy that no store through a pointer can be thought to change
    const double most = box.pair_scale > 0.0 ? exponents<true>(box) : exponents<false>(box);
    for (std::int64_t i = 0; i < box.length; i += num_lanes / 2) {
        store(box.weights + i, load<Doubles>(box.factors + i) * exponential(load<Doubles>(box.weights + i) - most));
    }
}

}  // namespace
}  // namespace foreglow
