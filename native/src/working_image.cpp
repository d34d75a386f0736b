#include "working_image.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>

namespace foreglow {

void WorkingImage::reduce(const ImageView& frame, std::int32_t reduction, const Kernels& kernels) {
    width = frame.width_px / reduction;
    height = frame.height_px / reduction;
    const std::int64_t white = frame.pixel_type == PixelType::u8 ? 255 : 65535;
    full_scale = white * reduction * reduction;
    is_narrow = full_scale < (1 << 15);
    const std::int64_t padded = (width + 2 * plane_quantum - 1) / (2 * plane_quantum) * (2 * plane_quantum);
    stride_ = padded + 2 * margin;
    if (width == 0 || height == 0) return;
    const auto size = static_cast<std::size_t>(stride_ * height);
    if (is_narrow) {
        narrow_.resize(size);
    } else {
        wide_.resize(size);
    }
    if (is_narrow && reduction == 2) {
        std::uint16_t extremes[2] = {65535, 0};
        for (std::int64_t y = 0; y < height; ++y) {
            kernels.halve(frame.row<std::uint8_t>(2 * y), frame.row<std::uint8_t>(2 * y + 1), width,
                          narrow_.data() + y * stride_ + margin, extremes);
        }
        darkest = extremes[0];
        brightest = extremes[1];
    } else if (is_narrow) {
        sum_blocks<std::uint8_t>(frame, reduction, narrow_);
    } else if (frame.pixel_type == PixelType::u8) {
        sum_blocks<std::uint8_t>(frame, reduction, wide_);
    } else {
        sum_blocks<std::uint16_t>(frame, reduction, wide_);
    }
    if (is_narrow) {
        mirror_border(narrow_);
    } else {
        mirror_border(wide_);
    }
}

template <typename Pixel, typename Sum>
void WorkingImage::sum_blocks(const ImageView& frame, std::int32_t reduction, AlignedVector<Sum>& sums) {
    columns_.resize(static_cast<std::size_t>(width * reduction));
    darkest = full_scale;
    brightest = 0;
    for (std::int64_t y = 0; y < height; ++y) {
        std::fill(columns_.begin(), columns_.end(), 0U);
        for (std::int32_t i = 0; i < reduction; ++i) {
            const Pixel* pixels = frame.row<Pixel>(y * reduction + i);
            for (std::size_t x = 0; x < columns_.size(); ++x) columns_[x] += pixels[x];
        }
        Sum* row = sums.data() + y * stride_ + margin;
        for (std::int64_t x = 0; x < width; ++x) {
            std::uint32_t sum = 0;
            for (std::int32_t i = 0; i < reduction; ++i) sum += columns_[x * reduction + i];
            row[x] = static_cast<Sum>(sum);
            darkest = std::min<std::int64_t>(darkest, sum);
            brightest = std::max<std::int64_t>(brightest, sum);
        }
    }
}

template <typename Sum>
void WorkingImage::mirror_border(AlignedVector<Sum>& sums) const {
    for (std::int64_t y = 0; y < height; ++y) {
        Sum* row = sums.data() + y * stride_ + margin;
        for (std::int64_t k = 1; k <= 2; ++k) {
            row[-k] = row[mirrored(-k, width)];
            row[width - 1 + k] = row[mirrored(width - 1 + k, width)];
        }
    }
}

double ExactBlur::at(std::int64_t x, std::int64_t y) const {
    double value = 0.0;
    for (std::int64_t j = -1; j <= 1; ++j) {
        double row = 0.0;
        const std::int64_t source = mirrored(y + j, image.height);
        for (std::int64_t i = -2; i <= 2; ++i) {
            row += across[std::abs(i)] * static_cast<double>(image.sum_at(source, x + i) - black);
        }
        value += down[std::abs(j)] * row;
    }
    return value / unit;
}

double ExactBlur::sum_over(const Box& window) const {
    double total = 0.0;
    // Rows and columns at most two beyond the window take part; a mirrored one counts where it comes from.
    const auto weight = [](const HalfKernel& kernel, std::int64_t reach, std::int64_t first, std::int64_t last,
                           std::int64_t position) {
        double sum = 0.0;
        for (std::int64_t k = -reach; k <= reach; ++k) {
            if (position + k >= first && position + k < last) sum += kernel[std::abs(k)];
        }
        return sum;
    };
    constexpr std::int64_t most_columns = 64;
    for (std::int64_t left = window.x1 - 2; left < window.x2 + 2; left += most_columns) {
        const std::int64_t right = std::min<std::int64_t>(left + most_columns, window.x2 + 2);
        double weights[most_columns];
        for (std::int64_t x = left; x < right; ++x) weights[x - left] = weight(across, 2, window.x1, window.x2, x);
        for (std::int64_t y = window.y1 - 1; y < window.y2 + 1; ++y) {
            const double row_weight = weight(down, 1, window.y1, window.y2, y);
            if (row_weight == 0.0) continue;
            const std::int64_t source = mirrored(y, image.height);
            double row = 0.0;
            if (image.is_narrow) {
                const std::uint16_t* sums = image.narrow_row(source) + left;
                for (std::int64_t i = 0; i < right - left; ++i) row += weights[i] * level(sums[i]);
            } else {
                const std::uint32_t* sums = image.wide_row(source) + left;
                for (std::int64_t i = 0; i < right - left; ++i) row += weights[i] * level(sums[i]);
            }
            total += row_weight * row;
        }
    }
    return total / unit;
}

double ExactBlur::deviation(const Box& box, std::vector<double>& scratch) const {
    const std::int64_t width = box.x2 - box.x1, height = box.y2 - box.y1;
    const auto area = static_cast<double>(width * height);
    // Rows box.y1 - 1 .. box.y2, blurred across, then blurred down in place.
    scratch.resize(static_cast<std::size_t>(width * (height + 2)));
    for (std::int64_t y = 0; y < height + 2; ++y) {
        const std::int64_t source = mirrored(box.y1 + y - 1, image.height);
        double* row = scratch.data() + y * width;
        const auto blur_row = [&](const auto* sums) {
            for (std::int64_t x = 0; x < width; ++x) {
                row[x] = across[2] * (level(sums[x - 2]) + level(sums[x + 2])) +
                         across[1] * (level(sums[x - 1]) + level(sums[x + 1])) +
                         across[0] * level(sums[x]);
            }
        };
        if (image.is_narrow) {
            blur_row(image.narrow_row(source) + box.x1);
        } else {
            blur_row(image.wide_row(source) + box.x1);
        }
    }
    double sum = 0.0;
    for (std::int64_t y = 0; y < height; ++y) {
        double* row = scratch.data() + y * width;
        for (std::int64_t x = 0; x < width; ++x) {
            row[x] = down[1] * (row[x] + row[x + 2 * width]) + down[0] * row[x + width];
            sum += row[x];
        }
    }
    const double mean = sum / area;
    double deviation = 0.0;
    for (std::int64_t i = 0; i < width * height; ++i) deviation += std::abs(scratch[static_cast<std::size_t>(i)] - mean);
    return deviation / (area * unit);
}

}  // namespace foreglow
