"""`inim film`: a report's display as an eye sees it that moves along a path."""
