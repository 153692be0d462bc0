"""Compiled kernels, candidates in SIMD lanes: the same results as the readable torch references, many times faster."""
