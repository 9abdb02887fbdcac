"""Touch against truth, random indenters."""
