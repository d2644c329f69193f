"""Run statistics: what later runs are compared with.

Every report has one (`regression/candidate.json` and `.npz`); accepted, with a reason, it is a
baseline (`baseline.json` and `.npz`). Both are of the schema `inim.baseline/2`.
"""

from __future__ import annotations

import hashlib
import io
import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from inim.documents import read_document, write_document
from inim.documents.compare import BaselineDocument, PictureSize
from inim.documents.parts import Circumstances, Conditions
from inim.errors import BaselineError, FileError
from inim.files.image import write_atomically
from inim.files.regular_file import read_file
from inim.regression.fingerprints import Fingerprint
from inim.regression.scores import ScoreEstimate
from inim.regression.tiles import TileStatistics

#: Names of the files, without what follows the dot.
BASELINE, CANDIDATE = "baseline", "candidate"

# More than any picture has tiles, or any file of ours bytes.
_LARGEST_BYTES = 2**26
_MOST_ARRAYS = 20_000
_ZIP_ENTRY = b"PK\1\2"
_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


@dataclass(frozen=True)
class RunStatistics:
    """Conditions, statistics of pictures, scores and times of a run.

    Attributes
    ----------
    conditions : Conditions
        They must be equal for a comparison.
    circumstances : Circumstances
        Versions, samples, seed, machine, date. They may differ.
    pictures : mapping of str to TileStatistics
    scores : mapping of str to mapping of str to ScoreEstimate
    fingerprints : mapping of str to Fingerprint
    times : mapping of str to tuple of float
        `times.log_ratios` by algorithm; empty where nothing was timed.
    reported : mapping of str to mapping of str to float or None
        Scores without a verdict, for their drift.
    reason, accepted : str
        Why and when it became a baseline; empty in a candidate.
    """

    conditions: Conditions
    circumstances: Circumstances
    pictures: Mapping[str, TileStatistics]
    scores: Mapping[str, Mapping[str, ScoreEstimate]]
    fingerprints: Mapping[str, Fingerprint] = field(default_factory=dict)
    times: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    reported: Mapping[str, Mapping[str, float | None]] = field(default_factory=dict)
    reason: str = ""
    accepted: str = ""

    def accept(self, reason: str, accepted: str) -> RunStatistics:
        """The same as a baseline."""
        return replace(self, reason=reason, accepted=accepted)


def write_statistics(folder: Path, stem: str, statistics: RunStatistics) -> list[str]:
    """Write `stem`.json and `stem`.npz into a folder; their names.

    Raises
    ------
    FileError
        The folder cannot be written.
    """
    stream = io.BytesIO()
    np.savez_compressed(stream, **_arrays(statistics))  # type: ignore[arg-type]
    packed = stream.getvalue()
    document = BaselineDocument(
        reason=statistics.reason,
        accepted=statistics.accepted,
        conditions=statistics.conditions,
        circumstances=statistics.circumstances,
        pictures={
            name: PictureSize(tile=tiles.tile, shape=tiles.shape)
            for name, tiles in statistics.pictures.items()
        },
        scores={
            what: {name: score.as_record() for name, score in scores.items()}
            for what, scores in statistics.scores.items()
        },
        fingerprints={name: one.as_record() for name, one in statistics.fingerprints.items()},
        times={name: list(ratios) for name, ratios in statistics.times.items()},
        reported={what: dict(scores) for what, scores in statistics.reported.items()},
        arrays_sha256=hashlib.sha256(packed).hexdigest(),
    )
    # The JSON last: it marks a whole one.
    names = [f"{stem}.json", f"{stem}.npz"]
    write_atomically(folder / names[1], lambda p: p.write_bytes(packed))
    write_document(folder / names[0], document)
    return names


def _arrays(statistics: RunStatistics) -> dict[str, np.ndarray]:
    arrays = {
        f"picture|{name}|{key}": array
        for name, found in statistics.pictures.items()
        for key, array in found.arrays().items()
    }
    return arrays | {f"sample|{n}": one.sample for n, one in statistics.fingerprints.items()}


def read_statistics(folder: Path, stem: str) -> RunStatistics:
    """Read what `write_statistics` wrote.

    Raises
    ------
    BaselineError
        Missing, damaged, or of another schema, with the way out.
    """
    path, way_out = folder / f"{stem}.json", _way_out(stem)
    try:
        data = read_document(path, way_out, BaselineDocument)
        packed = read_file(folder / f"{stem}.npz", _LARGEST_BYTES, way_out=way_out)
        if hashlib.sha256(packed).hexdigest() != data.arrays_sha256:
            raise ValueError("which is of another run; one that is just being replaced?")
        return _statistics(data, _arrays_in(packed))
    except FileError as error:
        raise BaselineError(str(error)) from None
    except (KeyError, ValueError) as error:
        words = " ".join(str(error).split())[:200]
        raise BaselineError(f"{path}: damaged with its .npz ({words}); {way_out}") from None


def _way_out(stem: str) -> str:
    if stem == BASELINE:
        return "make one: inim baseline accept OUT --reason TEXT"
    return "make the report anew with inim validate"


def _arrays_in(data: bytes) -> dict[str, np.ndarray]:
    """The arrays of an .npz; a ValueError where it is none, or unpacks to more than it may."""
    if data.count(_ZIP_ENTRY) > _MOST_ARRAYS:
        raise ValueError(f"more than {_MOST_ARRAYS} arrays")
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            if sum(one.file_size for one in packed.infolist()) > _LARGEST_BYTES:
                raise ValueError(f"unpacks to more than {_LARGEST_BYTES} bytes")
            return {
                one.filename.removesuffix(".npy"): _array(packed, one) for one in packed.infolist()
            }
    except Exception as error:  # of any kind: an array's header is read as Python
        raise ValueError(f"no readable arrays: {error}") from None


def _array(packed: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    """One array of plain numbers, of the size that its header declares."""
    with packed.open(entry) as file:
        version = np.lib.format.read_magic(file)
        read = _HEADERS.get(version)
        if read is None:
            raise ValueError(f"{entry.filename} is of version {version}")
        shape, _, dtype = read(file)
        if dtype.kind not in "fu" or min(shape, default=1) < 0:
            raise ValueError(f"{entry.filename} holds {dtype} of shape {shape}")
        values = file.read()
    if math.prod(shape) * dtype.itemsize != len(values):
        raise ValueError(f"{entry.filename} has {len(values)} bytes for the shape {shape}")
    return np.frombuffer(values, dtype).reshape(shape)


def _statistics(data: BaselineDocument, arrays: Mapping[str, np.ndarray]) -> RunStatistics:
    pictures = {
        name: TileStatistics.of(
            size.tile,
            size.shape,
            {key: arrays[f"picture|{name}|{key}"] for key in TileStatistics.array_names()},
        )
        for name, size in data.pictures.items()
    }
    return RunStatistics(
        conditions=data.conditions,
        circumstances=data.circumstances,
        pictures=pictures,
        scores={
            what: {name: ScoreEstimate.of(score) for name, score in scores.items()}
            for what, scores in data.scores.items()
        },
        fingerprints={
            name: Fingerprint.of(record, arrays[f"sample|{name}"])
            for name, record in data.fingerprints.items()
        },
        times={name: tuple(ratios) for name, ratios in data.times.items()},
        reported=data.reported,
        reason=data.reason,
        accepted=data.accepted,
    )
