"""Touch from pixels. Each stage has its folder, and `pipeline` connects the stages."""
