#define FOREGLOW_KERNELS kernels_baseline
#include "kernels.inl"
