"""How the memory there is is shared out between pictures and rays in flight.

Running out of memory is a native death, not an exception, so it is planned against: pictures have
to fit whole, and what they leave decides how many rays the renderer traces at once. Fewer rays a
pass cost time, not samples.
"""

from __future__ import annotations

__all__ = ["LEAST_BYTES", "rays_in_flight"]

# The renderer, its kernels and a scene. 0.3 GiB are filled for the relics of `scenes/`; a limit on
# addresses (`ulimit -v`) counts what is reserved too, and other scenes have larger meshes.
_RENDERER_BYTES = 2 * 2**30
# What a pass yields and its random numbers: 14 to 20 bytes a ray, measured with the amphora and
# the goblet between passes of 2^16 and 2^22 rays (a path's own state stays in registers); thrice
# that for longer results and other integrators.
_RAY_BYTES = 60
# Larger passes gain nothing on two cores; below the smallest, starting them costs more than they
# trace.
_MOST_RAYS = 2**22
_FEWEST_RAYS = 2**16

#: What a run takes beside its pictures where memory is short.
LEAST_BYTES = _RENDERER_BYTES + _FEWEST_RAYS * _RAY_BYTES


def rays_in_flight(limit_bytes: int, pictures_bytes: int) -> int:
    """Rays that may be traced at once: a power of two, or 0 where not even the fewest fit.

    Parameters
    ----------
    limit_bytes : int
        The memory there is (`inim.backend.memory_limit_bytes`); 0: not known, and not limited.
    pictures_bytes : int
        What the run's pictures take at their fullest moment.
    """
    if not limit_bytes:
        return _MOST_RAYS
    affordable = (limit_bytes - pictures_bytes - _RENDERER_BYTES) // _RAY_BYTES
    if affordable < _FEWEST_RAYS:
        return 0
    return int(min(_MOST_RAYS, 2 ** (affordable.bit_length() - 1)))
