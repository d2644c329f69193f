"""The version, in a separate module that lower layers may import."""

__version__ = "0.1.0"
