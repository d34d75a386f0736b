#include <algorithm>
#include <cmath>

#include "foreglow/hypotheses.hpp"

namespace foreglow {
namespace {

constexpr double squared(double value) { return value * value; }

// As LEAST_HORIZONTAL_M of foreglow.distance.hypotheses (Python): the camera may be right above a place.
double horizontal_squared(double forward_m, double left_m) {
    constexpr double least_m = 0.1;
    return std::max(squared(forward_m) + squared(left_m), squared(least_m));
}

// Where a kind's light is at a place, seen from the camera, and how its direction errs.
struct Seen {
    double forward_m, left_m, up_m;
    double variance_across, covariance, variance_up;
    bool is_known;
};

struct Angles {
    double across, up;
};

// At its height above the plane that we stand on, in any direction.
Seen on_plane(const HypothesisParameters& p, const LightKind& kind, const std::array<double, 3>& camera_m,
              std::size_t place) {
    return {p.places_m[place] - camera_m[0], 0.0, kind.height_m - camera_m[2], squared(p.anywhere_sigma_rad), 0.0,
            squared(p.plane_sigma_rad), true};
}

// On the kind's line along the road, with the errors of the map, of our place on it, and of the line itself.
Seen on_road(const HypothesisParameters& p, const LightKind& kind, const Ribbon& road,
             const std::array<double, 3>& camera_m, std::size_t place) {
    const double cos = road.cos[place], sin = road.sin[place], slope = road.slope[place];
    const double offset = kind.side * road.half_width_m + kind.offset_m;
    const double inside = std::min(std::max(offset, -road.half_width_m), road.half_width_m);
    const double x = road.x_m[place] - sin * offset, y = road.y_m[place] + cos * offset;
    const double fall_across = road.banking[place] * inside + road.crown[place] * std::abs(inside);
    const double up = road.z_m[place] - fall_across - road.rise_m - road.lean * y + kind.height_m - camera_m[2];
    const double forward = x - camera_m[0], left = y - camera_m[1];
    const double distance_squared = horizontal_squared(forward, left), level = std::sqrt(distance_squared);
    // Displacements become angles: across by the perpendicular over the distance, ...
    const double to_cos = forward / distance_squared, to_sin = left / distance_squared;
    const double inverse = 1.0 / level, fall = up * inverse;
    const auto angles = [&](double x_m, double y_m, double z_m) {
        return Angles{to_cos * y_m - to_sin * x_m, z_m * inverse - fall * (to_cos * x_m + to_sin * y_m)};
    };
    // ... of the place within its cell, along the road; ...
    const double cell_m = p.cell_sigmas_m[place];
    const Angles cell = angles(cell_m * cos, cell_m * sin, cell_m * slope);
    // ... of the whole road, when we are further along it than we believe: P' = T(s) - T(0) - kappa z x P; ...
    const double shift_m = road.shift_sigma_m, turn = road.curvature_per_m;
    const Angles shift = angles(shift_m * (cos - road.start_cos + turn * y), shift_m * (sin - road.start_sin - turn * x),
                                shift_m * (slope - road.start_slope));
    // ... and of the line across the road, over which it also rises.
    const double sigma = kind.offset_sigma_m, side = offset > 0.0 ? 1.0 : (offset < 0.0 ? -1.0 : 0.0);
    const double steep =
        std::abs(offset) <= road.half_width_m ? -road.banking[place] - road.crown[place] * side : 0.0;
    const Angles line = angles(-sin * sigma, cos * sigma, steep * sigma);
    return {forward,
            left,
            up,
            squared(cell.across) + squared(shift.across) + squared(line.across) + squared(road.yaw_sigma_rad) +
                squared(road.left_sigma_m * to_cos),
            cell.across * cell.up + shift.across * shift.up + line.across * line.up,
            squared(cell.up) + squared(shift.up) + squared(line.up),
            road.is_known[place]};
}

}  // namespace

void cells_along(const HypothesisParameters& parameters, const Ribbon* road, const std::array<double, 3>& camera_m,
                 double pitch_sigma_rad, double* columns) {
    const HypothesisParameters& p = parameters;
    const std::size_t num = p.places_m.size() * p.kinds.size();
    for (std::size_t i = 0; i < num; ++i) {
        const std::size_t place = i / p.kinds.size();
        const LightKind& kind = p.kinds[i % p.kinds.size()];
        const Seen seen = road == nullptr || kind.is_anywhere ? on_plane(p, kind, camera_m, place)
                                                              : on_road(p, kind, *road, camera_m, place);
        const double level_squared = horizontal_squared(seen.forward_m, seen.left_m), level = std::sqrt(level_squared);
        const double log_range = 0.5 * std::log(level_squared + squared(seen.up_m));
        const double tilt =
            (squared(pitch_sigma_rad * seen.forward_m) + squared(p.roll_sigma_rad * seen.left_m)) / level_squared;
        double* column = columns + i;
        const auto write = [&](double value) {
            *column = value;
            column += num;
        };
        write(std::atan2(seen.left_m, seen.forward_m));
        write(std::atan2(seen.up_m, level));
        write(seen.variance_across + squared(p.pixel_sigma_rad));
        write(seen.covariance);
        write(seen.variance_up + squared(p.pixel_sigma_rad) + squared(kind.height_sigma_m / level) + tilt +
              squared(p.slope_sigma));
        write(log_range);
        write(kind.log_share - 0.5 * squared((log_range - kind.log_range) / p.range_log_sigma) +
              (seen.is_known ? p.log_cells[place] : p.impossible));
    }
}

}  // namespace foreglow
