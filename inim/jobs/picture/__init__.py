"""Validating algorithms on one's own picture, without a scene: what can be scored, is.

There is no ground truth: nobody knows what the camera did not see. What the picture itself says is
known, and three things follow from it: which of its pixels each ray of the display meets first
(`oracle`), how the picture looks from each eye (`warp`), and how the EIA that shows just that does.
The rest is named, with the reason, in the report.
"""
