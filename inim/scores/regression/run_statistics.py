"""Run statistics: data of a run for comparisons with later runs.

Every report has a candidate (`regression/candidate.json` and `.npz`). An accepted candidate is a
baseline (`baseline.json` and `.npz`). Both follow the schema `inim.baseline/4`.
"""

import hashlib
import io
import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from inim.scores.document_parts import Circumstances, RunInputs
from inim.scores.regression.document import BaselineDocument, PictureSize
from inim.scores.regression.fingerprints import Fingerprint
from inim.scores.regression.scores import LIGHT, ScoreEstimate
from inim.scores.regression.tiles import TileStatistics
from inim.system.document import read_document, write_document
from inim.system.errors import BaselineError, FileError
from inim.system.files import read_file
from inim.system.process.atomic_file import write_atomically

#: Stems of the file names.
BASELINE, CANDIDATE = "baseline", "candidate"

# Limits above any file of this project.
_MAX_BYTES = 2**26
_MAX_ARRAYS = 20_000
_ZIP_ENTRY = b"PK\1\2"
_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


@dataclass(frozen=True)
class RunStatistics:
    """Inputs, image statistics and scores of a run.

    Circumstances are code, versions, samples, seed, machine and date. Only a baseline has the
    reason and the date of acceptance.
    """

    inputs: RunInputs
    circumstances: Circumstances
    pictures: Mapping[str, TileStatistics]
    scores: Mapping[str, Mapping[str, ScoreEstimate]]
    fingerprints: Mapping[str, Fingerprint] = field(default_factory=dict)
    reason: str = ""
    accepted: str = ""


def write_statistics(folder: Path, stem: str, statistics: RunStatistics) -> list[str]:
    """Write `stem`.json and `stem`.npz into a folder, and return their names."""
    arrays: dict[str, Any] = {
        f"picture|{name}|{key}": array
        for name, tiles in statistics.pictures.items()
        for key, array in tiles.arrays().items()
    }
    arrays |= {f"sample|{name}": f.sample for name, f in statistics.fingerprints.items()}
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    data = stream.getvalue()
    document = BaselineDocument(
        reason=statistics.reason,
        accepted=statistics.accepted,
        inputs=statistics.inputs,
        circumstances=statistics.circumstances,
        pictures={
            name: PictureSize(tile=tiles.tile, shape=tiles.shape)
            for name, tiles in statistics.pictures.items()
        },
        scores={
            scored: {name: score.as_record() for name, score in scores.items()}
            for scored, scores in statistics.scores.items()
        },
        fingerprints={name: f.as_record() for name, f in statistics.fingerprints.items()},
        arrays_sha256=hashlib.sha256(data).hexdigest(),
    )
    # The JSON file is last: its presence means that both are complete.
    names = [f"{stem}.json", f"{stem}.npz"]
    write_atomically(folder / names[1], lambda p: p.write_bytes(data))
    write_document(folder / names[0], document)
    return names


def read_statistics(folder: Path, stem: str) -> RunStatistics:
    """Read the files of `write_statistics`.

    Raises `BaselineError` if the files are missing, damaged, or have another schema.
    """
    path, fix = folder / f"{stem}.json", "make a new report with inim validate"
    if stem == BASELINE:
        fix = "make one: inim accept OUT --reason TEXT"
    if folder.is_file():
        raise BaselineError(f"{folder}: is a file; give the folder that holds {stem}.json")
    try:
        document = read_document(path, fix, BaselineDocument)
        data = read_file(folder / f"{stem}.npz", _MAX_BYTES, remedy=fix)
        if hashlib.sha256(data).hexdigest() != document.arrays_sha256:
            raise ValueError("it belongs to another run, or is being replaced")
        if not (document.pictures and document.scores):
            raise ValueError("it has no image or no score to compare")
        return _statistics(document, _read_arrays(data))
    except FileError as error:
        raise BaselineError(str(error)) from None
    except (KeyError, ValueError) as error:
        cause = " ".join(str(error).split())[:200]
        raise BaselineError(f"{path}: damaged, or its .npz is ({cause}); {fix}") from None


def _read_arrays(data: bytes) -> dict[str, np.ndarray]:
    """Read the arrays of an .npz; raises ValueError if it is invalid or too large."""
    if data.count(_ZIP_ENTRY) > _MAX_ARRAYS:
        raise ValueError(f"more than {_MAX_ARRAYS} arrays")
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
            if sum(entry.file_size for entry in entries) > _MAX_BYTES:
                raise ValueError(f"unpacks to more than {_MAX_BYTES} bytes")
            return {e.filename.removesuffix(".npy"): _read_array(archive, e) for e in entries}
    except Exception as error:  # of any type: an array's header is read as Python
        raise ValueError(f"no readable arrays: {error}") from None


def _read_array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    """Read an array of plain numbers, of the size that its header declares."""
    with archive.open(entry) as file:
        version = np.lib.format.read_magic(file)
        read_header = _HEADERS.get(version)
        if read_header is None:
            raise ValueError(f"{entry.filename} is of version {version}")
        shape, _, dtype = read_header(file)
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
    scores = {
        scored: {name: ScoreEstimate.of(score) for name, score in by_name.items()}
        for scored, by_name in data.scores.items()
    }
    for scored, by_name in scores.items():
        for name, score in by_name.items():
            if name.startswith(f"{LIGHT}_") and not math.isfinite(score.plain):
                raise ValueError(f"{scored}: {name} is not a number")
    return RunStatistics(
        inputs=data.inputs,
        circumstances=data.circumstances,
        pictures=pictures,
        scores=scores,
        fingerprints={
            name: Fingerprint.of(record, arrays[f"sample|{name}"])
            for name, record in data.fingerprints.items()
        },
        reason=data.reason,
        accepted=data.accepted,
    )
