"""Benchmarks: correctness first, then medians, beside what the machine can do and beside the reference in the same run."""
