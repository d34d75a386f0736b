#include "dispatch.hpp"

#include <algorithm>
#include <stdexcept>
#include <string>

namespace foreglow {

std::vector<Dispatch> available_dispatch() {
    std::vector<Dispatch> available = {Dispatch::baseline};
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) {
        available.push_back(Dispatch::avx2);
        if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
            __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl") &&
            __builtin_cpu_supports("avx512vnni")) {
            available.push_back(Dispatch::avx512);
        }
    }
#endif
    return available;
}

const char* name_of(Dispatch dispatch) {
    switch (dispatch) {
        case Dispatch::avx2: return "avx2";
        case Dispatch::avx512: return "avx512";
        default: return "baseline";
    }
}

const Kernels& kernels_for(Dispatch dispatch) {
    const auto available = available_dispatch();
    if (std::find(available.begin(), available.end(), dispatch) == available.end()) {
        throw std::invalid_argument(std::string("dispatch: this processor lacks ") + name_of(dispatch));
    }
#if defined(__x86_64__)
    if (dispatch == Dispatch::avx512) return kernels_avx512;
    if (dispatch == Dispatch::avx2) return kernels_avx2;
#endif
    return kernels_baseline;
}

}  // namespace foreglow
