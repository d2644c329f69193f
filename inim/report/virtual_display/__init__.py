"""The virtual display: an EIA through its lens array, drawn live in the page by WebGL.

Without scripts or WebGL 2, views rendered beforehand stand in.
"""
