"""Names of inim-bench 1; loads no other module, so that help is fast."""

#: Name and version of the benchmark: part of every submission and result.
PROTOCOL = "inim-bench-1.0"
#: Inputs of an algorithm, by track.
TRACKS = {
    "rgbd": "one RGB-D picture",
    "cameras": "five RGB-D pictures: the centre and the corners of the viewing zone",
    "mesh": "the relic's mesh, textures and lights",
    "blind": "one RGB-D picture; the array deviates from its design by an unknown amount",
}
#: Sets of cases.
TIER_NAMES = ("small", "full")
#: Public seeds: of the renderer's noise, and of the deviations in the track `blind`.
SEED, BLIND_SEED = 1, 1
