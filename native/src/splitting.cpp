#include "splitting.hpp"

#include <algorithm>

namespace foreglow {

void BlobSplitter::start(std::int64_t width, std::int64_t height) {
    num_words_ = (width + 127) / 128;
    bits_.resize(static_cast<std::size_t>(2 * num_words_ * height));
    y_ = 0;
}

void BlobSplitter::add_row(const BinaryRow& row) {
    std::uint64_t* words = bits_.data() + 2 * y_ * num_words_;
    std::copy(row.even, row.even + num_words_, words);
    std::copy(row.odd, row.odd + num_words_, words + num_words_);
    ++y_;
}

std::int32_t BlobSplitter::root(std::int32_t part) {
    while (parts_[part].parent != part) {
        parts_[part].parent = parts_[parts_[part].parent].parent;
        part = parts_[part].parent;
    }
    return part;
}

// The set pixels, from the highest level down, row by row where levels are equal.
void BlobSplitter::collect(const Box& box, const WorkingImage& image, std::int64_t black, std::int64_t range) {
    pixels_.clear();
    starts_.assign(top_level + 2, 0);
    const std::int64_t whole = 16 * range;
    for (std::int64_t y = box.y1; y < box.y2; ++y) {
        const std::int64_t above = std::max<std::int64_t>(y - 1, 0), below = std::min(y + 1, image.height - 1);
        for (std::int64_t x = box.x1; x < box.x2; ++x) {
            if (!is_set(x, y)) continue;
            const std::int64_t left = std::max<std::int64_t>(x - 1, 0), right = std::min(x + 1, image.width - 1);
            const auto across = [&](std::int64_t row) {
                return image.sum_at(row, left) + 2 * image.sum_at(row, x) + image.sum_at(row, right);
            };
            const std::int64_t light = across(above) + 2 * across(y) + across(below) - 16 * black;
            const auto level = static_cast<std::int16_t>(light * top_level / whole);
            pixels_.push_back({level, static_cast<std::int32_t>(x - box.x1), static_cast<std::int32_t>(y - box.y1)});
            ++starts_[top_level - level + 1];
        }
    }
    for (std::size_t i = 1; i < starts_.size(); ++i) starts_[i] += starts_[i - 1];
    sorted_.resize(pixels_.size());
    for (const Pixel& pixel : pixels_) sorted_[starts_[top_level - pixel.level]++] = pixel;
}

void BlobSplitter::widen(Part& part, const Box& box) {
    if (part.is_closed) return;
    part.extent = {std::min(part.extent.x1, box.x1), std::min(part.extent.y1, box.y1),
                   std::max(part.extent.x2, box.x2), std::max(part.extent.y2, box.y2)};
}

void BlobSplitter::flood(std::int32_t width, std::int32_t height, const SplitRule& rule) {
    const std::int32_t stride = width + 2;
    part_of_.assign(static_cast<std::size_t>(stride) * (height + 2), -1);
    parts_.clear();
    const std::int32_t around[8] = {-stride - 1, -stride, -stride + 1, -1, 1, stride - 1, stride, stride + 1};
    for (const Pixel& pixel : sorted_) {
        const std::int32_t place = (pixel.y + 1) * stride + pixel.x + 1;
        std::int32_t met[8], num_met = 0, highest = -1;
        for (const std::int32_t step : around) {
            const std::int32_t part = part_of_[place + step];
            if (part < 0) continue;
            const std::int32_t found = root(part);
            if (std::find(met, met + num_met, found) != met + num_met) continue;
            met[num_met++] = found;
            // The earlier of two equal peaks counts as the higher one.
            if (highest < 0 || parts_[found].peak > parts_[highest].peak ||
                (parts_[found].peak == parts_[highest].peak && found < highest)) {
                highest = found;
            }
        }
        if (highest < 0) {
            highest = static_cast<std::int32_t>(parts_.size());
            parts_.push_back({highest, pixel.level, 0, {pixel.x, pixel.y, pixel.x + 1, pixel.y + 1}});
        }
        part_of_[place] = highest;
        Part& whole = parts_[highest];
        ++whole.num_pixels;
        widen(whole, {pixel.x, pixel.y, pixel.x + 1, pixel.y + 1});
        if (num_met > 2) std::sort(met, met + num_met);  // what closes a part must not depend on where it was met
        for (std::int32_t i = 0; i < num_met; ++i) {
            Part& part = parts_[met[i]];
            if (met[i] == highest) continue;
            const bool is_shallow = static_cast<double>(pixel.level) > rule.saddle * static_cast<double>(part.peak);
            if (!is_shallow && static_cast<double>(part.num_pixels) >= rule.min_area_px) {
                part.is_closed = whole.is_closed = true;
                continue;
            }
            part.parent = highest;
            whole.num_pixels += part.num_pixels;
            widen(whole, part.extent);
        }
    }
}

void BlobSplitter::split(const Box& box, const WorkingImage& image, std::int64_t black, std::int64_t range,
                         const SplitRule& rule, std::vector<Box>& parts) {
    collect(box, image, black, range);
    flood(box.x2 - box.x1, box.y2 - box.y1, rule);
    const std::size_t before = parts.size();
    for (std::size_t i = 0; i < parts_.size(); ++i) {
        const Box& extent = parts_[i].extent;
        const auto width = static_cast<double>(extent.x2 - extent.x1), height = static_cast<double>(extent.y2 - extent.y1);
        if (parts_[i].parent != static_cast<std::int32_t>(i) || width * height < rule.min_area_px ||
            width < rule.min_width_px) {
            continue;
        }
        parts.push_back({box.x1 + extent.x1, box.y1 + extent.y1, box.x1 + extent.x2, box.y1 + extent.y2});
    }
    if (parts.size() < before + 2) {
        parts.resize(before);
        parts.push_back(box);
    }
}

}  // namespace foreglow
