"""The paper's own methods, kept as baselines that benchmarks compare with."""
