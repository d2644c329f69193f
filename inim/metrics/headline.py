"""The headline score: the one by which algorithms are ranked, everywhere.

It is `MAIN` on the relic, to the ceiling.
"""

from __future__ import annotations

from inim.metrics.ssim import metric

MAIN = metric
#: Keys of the headline score and of the same score to the scene.
HEADLINE, HEADLINE_TO_SCENE = MAIN.on_relic_to_ceiling_key, MAIN.on_relic_key
HEADLINE_WORDS = f"{MAIN.label} on the relic, to the ceiling"
