"""Sampler plugin `inim_counter`: counter-based, well-distributed random numbers.

The numbers of a sample depend only on (seed, pixel, sample), not on the other traced pixels, their
order or the number of passes. Every pair of numbers that a path requests is a point of the Sobol'
(0, 2)-sequence, with a separate order and Owen scrambling for each seed, pixel and pair (Burley,
"Practical hash-based Owen scrambling", JCGT 9(4), 2020). docs/theory/ground-truth.md, "Colour",
has the consequences.
"""

from typing import Any

from inim.render.library import dr, mi

PLUGIN = "inim_counter"

# Multipliers of the Laine-Karras permutation, as improved by Vegdahl (2021).
_PERMUTATION = (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6)
# Of the integer hash by Wellons (2018), "lowbias32".
_HASH = ((16, 0x7FEB352D), (15, 0x846CA68B))
# The sequence's second axis is Pascal's triangle mod 2, whose blocks repeat at every scale: shifts
# and the bits they take.
_PASCAL = ((16, 0xFFFF0000), (8, 0xFF00FF00), (4, 0xF0F0F0F0), (2, 0xCCCCCCCC), (1, 0xAAAAAAAA))
_TO_UNIT = 2.0**-24


def _hash(x: Any) -> Any:
    """Hash of a number, UInt32."""
    for shift, factor in _HASH:
        x = (x ^ (x >> shift)) * factor
    return x ^ (x >> 16)


def _scramble(x: Any, seed: Any) -> Any:
    """Owen scrambling: each bit turned over or not, by the bits above it."""
    x = dr.brev(x) + seed
    for factor in _PERMUTATION:
        x ^= x * factor
    return dr.brev(x)


def _second_axis(index: Any) -> Any:
    """The second coordinate of the sequence's points, UInt32; the first is `brev(index)`."""
    for shift, bits in _PASCAL:
        index ^= (index & bits) >> shift
    return dr.brev(index)


def _to_unit_interval(x: Any) -> Any:
    """A UInt32 as a number in [0, 1): 24 bits, so that it cannot round to 1."""
    return mi.Float(x >> 8) * _TO_UNIT


def register() -> None:
    """Define and register the class again: plugins belong to the active variant."""

    class CounterSampler(mi.Sampler):  # type: ignore[misc]
        """A stream of numbers for each pixel and sample."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self._sample: Any = None
            self._stream: Any = None

        def start(self, seed: Any, pixel: Any, sample: Any) -> None:
            """Begin the streams of samples; each argument is (n,) UInt32, or one number for all."""
            self._sample = mi.UInt32(sample)
            self._stream = _hash(_hash(pixel) + _hash(mi.UInt32(seed)))

        def _next(self, active: Any) -> tuple[Any, Any]:
            """Position of a path's next number or pair in the sequence, and its own key."""
            key = _hash(self._stream)
            # The stream goes on by a step that is prime to its period.
            self._stream = dr.select(mi.Mask(active), self._stream + 0x9E3779B9, self._stream)
            return _scramble(self._sample, key), key

        def schedule_state(self) -> None:
            dr.schedule(self._stream)

        def next_1d(self, active: Any = True) -> Any:
            index, key = self._next(active)
            return _to_unit_interval(_scramble(dr.brev(index), _hash(key ^ 0x55555555)))

        def next_2d(self, active: Any = True) -> Any:
            index, key = self._next(active)
            return mi.Point2f(
                _to_unit_interval(_scramble(dr.brev(index), _hash(key ^ 0x55555555))),
                _to_unit_interval(_scramble(_second_axis(index), _hash(key ^ 0xAAAAAAAA))),
            )

        def to_string(self) -> str:
            return PLUGIN

    mi.register_sampler(PLUGIN, CounterSampler)
