"""Pictures as values: RGB-D, colour conversions and buffers."""
