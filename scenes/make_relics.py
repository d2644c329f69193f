"""Make the relics of the example scenes: meshes (binary PLY) and textures (PNG).

``python scenes/make_relics.py`` rewrites ``scenes/meshes`` and ``scenes/textures``, byte for byte
the same on every run; relics can be named, and ``-o FOLDER`` writes elsewhere.
"""

import argparse
from pathlib import Path

import numpy as np
from relics import altar, amphora, ibex, jade, tripod, wine_coin

SCENES = Path(__file__).resolve().parent
SEED = 20240901
RELICS = {
    "amphora": amphora,
    "wine_coin": wine_coin,
    "tripod": tripod,
    "jade": jade,
    "ibex": ibex,
    "altar": altar,
}


def main() -> None:
    """Make all relics, or the named ones; each has random numbers of its own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(RELICS))
    parser.add_argument("-o", "--out", type=Path, default=SCENES, help="folder (default: scenes)")
    args = parser.parse_args()
    unknown = sorted(set(args.names) - set(RELICS))
    if unknown:
        parser.error(f"{unknown[0]}: no such relic; there are {', '.join(RELICS)}")
    for number, (name, relic) in enumerate(RELICS.items()):
        if name in (args.names or RELICS):
            relic.make(args.out, np.random.default_rng([SEED, number]))


if __name__ == "__main__":
    main()
