"""The stages of a validation, a file each, and what caches and times them."""
