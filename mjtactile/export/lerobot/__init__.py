"""LeRobotDataset v3: info, stats, tasks and episodes as parquet, images as video or PNG. Written
with pyarrow and PyAV alone."""
