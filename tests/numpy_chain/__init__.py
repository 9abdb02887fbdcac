"""The sensing chain's stages in numpy, as they were before they were compiled: what the kernels are
compared with."""
