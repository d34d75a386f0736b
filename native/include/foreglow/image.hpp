// A view of a grey image that somebody else owns, and the box that is found in one.
#pragma once

#include <cstddef>
#include <cstdint>

namespace foreglow {

enum class PixelType : std::uint8_t { u8, u16 };

// Pixels of one row are adjacent; rows are `row_stride_bytes` apart, which may be negative.
struct ImageView {
    const void* data = nullptr;
    std::int32_t width_px = 0;
    std::int32_t height_px = 0;
    std::ptrdiff_t row_stride_bytes = 0;
    PixelType pixel_type = PixelType::u8;

    template <typename Pixel>
    const Pixel* row(std::int64_t y) const {
        return reinterpret_cast<const Pixel*>(static_cast<const char*>(data) + y * row_stride_bytes);
    }
};

// Half-open, full-frame pixels: columns x1 <= x < x2, rows y1 <= y < y2.
struct Box {
    std::int32_t x1 = 0, y1 = 0, x2 = 0, y2 = 0;

    friend bool operator==(const Box& a, const Box& b) {
        return a.x1 == b.x1 && a.y1 == b.y1 && a.x2 == b.x2 && a.y2 == b.y2;
    }
};

}  // namespace foreglow
