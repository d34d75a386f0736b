// Whether neighbouring rows, or columns, of an image change in turn, as where every second one is stuck or black.
// The specification is in Python: tests/beam/image_stripes_reference.py.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "foreglow/image.hpp"

namespace foreglow {

// Rows that are so far apart are compared.
constexpr std::array<std::int64_t, 6> stripe_lags_px{1, 2, 3, 4, 6, 8};

// For each lag the median difference of the changes of two rows, relative to their sum; and how much neighbours differ
// over how much the next but one do.
using Alternation = std::array<double, stripe_lags_px.size() + 1>;

// Compares bands of adjacent rows, and of adjacent columns, with those of the image before. One object a thread.
class ImageStripes {
public:
    // Returns whether there was an image before, of the same size and type; only then the rest is written: by rows, by
    // columns. `top` is the greatest value that a pixel may have.
    bool update(const ImageView& image, std::int32_t top, std::array<Alternation, 2>& found);

    // Forgets the image before.
    void reset();

private:
    struct Bands {
        std::int64_t num = 0, num_across = 0, num_in_band = 0;
        std::vector<std::int32_t> pixels;  // [band][across][row]; of this type, as differences of it are quick
    };

    template <typename Pixel>
    void cut(const ImageView& image);

    static Alternation alternation(const Bands& before, const Bands& now, std::int32_t top);

    std::int32_t width_px_ = 0, height_px_ = 0;
    PixelType pixel_type_ = PixelType::u8;
    std::array<Bands, 2> before_, now_;  // of rows, of columns
};

}  // namespace foreglow
