// Vectors of the widest size that the translation unit is compiled for, and the few operations that plain operators
// do not give. Included by the kernels only; everything has internal linkage, so that code compiled for a newer
// processor can never be linked in place of code for an older one.
#pragma once

#include <cstdint>
#include <cstring>

#if defined(__SSE2__)
#include <immintrin.h>
#endif

namespace {

#if defined(__AVX512BW__)
constexpr int num_lanes = 16;
#elif defined(__AVX2__)
constexpr int num_lanes = 8;
#else
constexpr int num_lanes = 4;
#endif
constexpr int vector_bytes = num_lanes * 4;

using Floats = float __attribute__((vector_size(vector_bytes)));
using Ints = std::int32_t __attribute__((vector_size(vector_bytes)));
using Words = std::uint32_t __attribute__((vector_size(vector_bytes)));
using Doubles = double __attribute__((vector_size(vector_bytes)));  // half as many
using Longs = std::int64_t __attribute__((vector_size(vector_bytes)));
using Shorts = std::int16_t __attribute__((vector_size(vector_bytes)));  // twice as many lanes

template <typename Vector, typename Scalar>
inline Vector load(const Scalar* from) {
    Vector vector;
    std::memcpy(&vector, from, sizeof vector);
    return vector;
}

template <typename Vector, typename Scalar>
inline void store(Scalar* to, Vector vector) {
    std::memcpy(to, &vector, sizeof vector);
}

inline Floats splat(float value) { return Floats{} + value; }
inline Floats to_floats(Ints values) { return __builtin_convertvector(values, Floats); }

// A vector of the pair (low, high) in every 32-bit lane.
inline Shorts splat_pair(std::int16_t low, std::int16_t high) {
    const auto word = static_cast<std::int32_t>(static_cast<std::uint16_t>(low) |
                                                static_cast<std::uint32_t>(static_cast<std::uint16_t>(high)) << 16);
    return reinterpret_cast<Shorts>(Ints{} + word);
}

#if defined(__AVX512BW__)

// sum + the products of 16-bit pairs
inline Ints add_dot_pairs(Ints sum, Shorts a, Shorts b) {
    return reinterpret_cast<Ints>(_mm512_dpwssd_epi32(reinterpret_cast<__m512i>(sum), reinterpret_cast<__m512i>(a),
                                                      reinterpret_cast<__m512i>(b)));
}
inline std::uint64_t greater_mask(Floats a, Floats b) { return _mm512_cmp_ps_mask(a, b, _CMP_GT_OQ); }
inline Floats magnitude(Floats values) { return _mm512_abs_ps(values); }
inline Doubles square_root(Doubles values) { return _mm512_sqrt_pd(values); }
inline Words running_sum(Words values) {
    const __m512i zero = _mm512_setzero_si512();
    auto v = reinterpret_cast<__m512i>(values);
    v = _mm512_add_epi32(v, _mm512_alignr_epi32(v, zero, 15));
    v = _mm512_add_epi32(v, _mm512_alignr_epi32(v, zero, 14));
    v = _mm512_add_epi32(v, _mm512_alignr_epi32(v, zero, 12));
    v = _mm512_add_epi32(v, _mm512_alignr_epi32(v, zero, 8));
    return reinterpret_cast<Words>(v);
}
inline Words splat_last(Words values) {
    return reinterpret_cast<Words>(
        _mm512_permutexvar_epi32(_mm512_set1_epi32(15), reinterpret_cast<__m512i>(values)));
}
// Sums of adjacent bytes, as 16-bit numbers.
inline Shorts sum_byte_pairs(Shorts bytes) {
    return reinterpret_cast<Shorts>(_mm512_maddubs_epi16(reinterpret_cast<__m512i>(bytes), _mm512_set1_epi8(1)));
}

#elif defined(__AVX2__)

inline Ints add_dot_pairs(Ints sum, Shorts a, Shorts b) {
    return sum + reinterpret_cast<Ints>(_mm256_madd_epi16(reinterpret_cast<__m256i>(a), reinterpret_cast<__m256i>(b)));
}
inline std::uint64_t greater_mask(Floats a, Floats b) {
    return static_cast<std::uint64_t>(_mm256_movemask_ps(_mm256_cmp_ps(a, b, _CMP_GT_OQ)));
}
inline Floats magnitude(Floats values) {
    return _mm256_andnot_ps(_mm256_set1_ps(-0.0F), values);
}
inline Doubles square_root(Doubles values) { return _mm256_sqrt_pd(values); }
inline Words running_sum(Words values) {
    auto v = reinterpret_cast<__m256i>(values);
    v = _mm256_add_epi32(v, _mm256_slli_si256(v, 4));
    v = _mm256_add_epi32(v, _mm256_slli_si256(v, 8));
    // The upper half still lacks the lower half's total.
    const __m256i low_total = _mm256_permutevar8x32_epi32(v, _mm256_set1_epi32(3));
    v = _mm256_add_epi32(v, _mm256_blend_epi32(_mm256_setzero_si256(), low_total, 0xF0));
    return reinterpret_cast<Words>(v);
}
inline Words splat_last(Words values) {
    return reinterpret_cast<Words>(
        _mm256_permutevar8x32_epi32(reinterpret_cast<__m256i>(values), _mm256_set1_epi32(7)));
}
inline Shorts sum_byte_pairs(Shorts bytes) {
    return reinterpret_cast<Shorts>(_mm256_maddubs_epi16(reinterpret_cast<__m256i>(bytes), _mm256_set1_epi8(1)));
}

#else

inline Floats magnitude(Floats values) {
    return reinterpret_cast<Floats>(reinterpret_cast<Ints>(values) & 0x7FFFFFFF);
}
inline Shorts sum_byte_pairs(Shorts bytes) {
    using Halves = std::uint16_t __attribute__((vector_size(vector_bytes)));
    const auto pairs = reinterpret_cast<Halves>(bytes);
    return reinterpret_cast<Shorts>((pairs & 0xFF) + (pairs >> 8));
}
#if defined(__SSE2__)
inline Ints add_dot_pairs(Ints sum, Shorts a, Shorts b) {
    return sum + reinterpret_cast<Ints>(_mm_madd_epi16(reinterpret_cast<__m128i>(a), reinterpret_cast<__m128i>(b)));
}
inline std::uint64_t greater_mask(Floats a, Floats b) {
    return static_cast<std::uint64_t>(_mm_movemask_ps(_mm_cmpgt_ps(a, b)));
}
inline Doubles square_root(Doubles values) { return _mm_sqrt_pd(values); }
inline Words running_sum(Words values) {
    auto v = reinterpret_cast<__m128i>(values);
    v = _mm_add_epi32(v, _mm_slli_si128(v, 4));
    v = _mm_add_epi32(v, _mm_slli_si128(v, 8));
    return reinterpret_cast<Words>(v);
}
inline Words splat_last(Words values) {
    return reinterpret_cast<Words>(_mm_shuffle_epi32(reinterpret_cast<__m128i>(values), 0xFF));
}
#else  // any other processor, arm64 above all: vector operators and short loops
inline Ints add_dot_pairs(Ints sum, Shorts a, Shorts b) {
    const auto x = reinterpret_cast<Ints>(a), y = reinterpret_cast<Ints>(b);
    const auto low_x = reinterpret_cast<Ints>(reinterpret_cast<Words>(x) << 16) >> 16;
    const auto low_y = reinterpret_cast<Ints>(reinterpret_cast<Words>(y) << 16) >> 16;
    return sum + low_x * low_y + (x >> 16) * (y >> 16);
}
inline std::uint64_t greater_mask(Floats a, Floats b) {
    const Ints bits = (a > b) & Ints{1, 2, 4, 8};
    return static_cast<std::uint64_t>(bits[0] | bits[1] | bits[2] | bits[3]);
}
inline Doubles square_root(Doubles values) { return Doubles{__builtin_sqrt(values[0]), __builtin_sqrt(values[1])}; }
inline Words running_sum(Words values) {
    for (int i = 1; i < num_lanes; ++i) values[i] += values[i - 1];
    return values;
}
inline Words splat_last(Words values) { return Words{} + values[num_lanes - 1]; }
#endif
#endif

template <typename Vector>
inline Vector smaller(Vector a, Vector b) { return a < b ? a : b; }
inline Shorts larger(Shorts a, Shorts b) { return a > b ? a : b; }

}  // namespace
