// The proposal stage: boxes that stand out against their surroundings and may hold a light artifact.
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "foreglow/dispatch.hpp"
#include "foreglow/image.hpp"

namespace foreglow {

enum class Window : std::uint8_t {
    published,  // x-h+1 .. x+h, never row 0 and column 0: 2h x 2h, off-centre by half a pixel
    centred,    // x-h .. x+h
};

// Parameters of the paper's detector. Sizes are working pixels for a frame of `reference_width_px` columns;
// `working_sizes` scales them to others. The fields are explained in foreglow.config.ProposalConfig (Python).
struct ProposalParameters {
    double kappa = 0.4;
    std::int32_t window_px = 19;
    double eps = 1e-3;
    double min_deviation = 0.01;
    std::int32_t gap_px = 4;
    double min_area_px = 11.0;
    double max_area_px = 1999.0;
    double min_width_px = 6.0;
    double split_saddle = 0.0;
    std::int32_t reduction = 2;
    std::int32_t reference_width_px = 1280;
    bool normalise = true;
    std::int32_t blur_width_px = 5;   // 1, 3 or 5
    std::int32_t blur_height_px = 3;  // 1 or 3
    double blur_sigma_px = 2.0;
    Window window = Window::published;
    std::optional<Box> region;  // considered part of the frame, cut at its border
};

struct WorkingSizes {
    std::int32_t reduction = 1;
    std::int32_t half_window_px = 1;
    std::int32_t gap_px = 1;
    double min_area_px = 0.0, max_area_px = 0.0, min_width_px = 0.0;
};

WorkingSizes working_sizes(const ProposalParameters& parameters, std::int32_t width_px);

// Finds proposals in one frame after another. Scratch memory is kept between frames; use one object a thread.
class ProposalGenerator {
public:
    // Throws std::invalid_argument when a parameter is out of range or this processor lacks `dispatch`
    // (by default the best that it has).
    explicit ProposalGenerator(const ProposalParameters& parameters, std::optional<Dispatch> dispatch = std::nullopt);
    ~ProposalGenerator();
    ProposalGenerator(ProposalGenerator&&) noexcept;
    ProposalGenerator& operator=(ProposalGenerator&&) noexcept;

    // Boxes in full-frame pixels, sorted by y1, x1, y2, x2; valid until the next call.
    // Throws std::invalid_argument when the considered region lies outside the image.
    const std::vector<Box>& propose(const ImageView& image);

    Dispatch dispatch() const;
    // Pixels of the last frame that single precision left in doubt and double precision decided.
    std::int64_t num_doubtful() const;

private:
    class Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace foreglow
