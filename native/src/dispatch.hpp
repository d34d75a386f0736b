// Which kernels this processor can run.
#pragma once

#include "foreglow/dispatch.hpp"
#include "kernels.hpp"

namespace foreglow {

// Throws std::invalid_argument when this processor lacks `dispatch`.
const Kernels& kernels_for(Dispatch dispatch);

}  // namespace foreglow
