"""What compiled kernels share: how they are started, kept and launched, with candidates in SIMD lanes."""
