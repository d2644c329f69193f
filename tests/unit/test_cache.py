"""The result cache: whole records or none, within its size, whoever else uses it."""

import os
from pathlib import Path

import numpy as np
import pytest

from inim.system.cache import (
    Record,
    Store,
    array_digest,
    cache_address,
    code_digest,
    value_digest,
)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store", 2**24)


def picture(seed: int, size: int = 100) -> np.ndarray:
    return np.random.default_rng(seed).random((size, size), np.float32)


def test_stored_records_are_loaded_back(store):
    arrays = {"a": picture(1), "covered": picture(2) > 0.5, "none": np.zeros((0, 3))}
    facts = {"score": 1 / 3, "infinite": float("inf"), "missing": None, "names": ["a", "ü"]}
    assert store.load("x") is None
    assert store.keep("x", Record(arrays, facts))
    loaded = store.load("x")
    assert loaded.facts == facts
    assert loaded.arrays.keys() == arrays.keys()
    for name, array in arrays.items():
        assert np.array_equal(loaded.arrays[name], array)
        assert loaded.arrays[name].dtype == array.dtype


def test_a_damaged_record_is_made_again_never_read(store):
    """Every byte counts: any one that is changed, or any end cut off, is found out."""
    whole = Record({"a": picture(1, 10)}, {"score": 0.5})
    store.keep("x", whole)
    path = store.folder / "x.npz"
    good = path.read_bytes()
    random = np.random.default_rng(0)
    for place in random.integers(0, len(good), 300):
        bad = bytearray(good)
        bad[place] ^= 1 << random.integers(8)
        path.write_bytes(bytes(bad))
        loaded = store.load("x")
        # Some bytes, such as a time of writing, mean nothing.
        same = loaded is not None and np.array_equal(loaded.arrays["a"], whole.arrays["a"])
        assert loaded is None or (same and loaded.facts == whole.facts)
    for length in range(0, len(good), 37):
        path.write_bytes(good[:length])
        assert store.load("x") is None
        assert not path.exists()


def test_a_record_under_another_name_is_not_loaded(store):
    """Copied, renamed or linked: whole as it is, it is not what was asked for."""
    store.keep("x", Record({"a": picture(1)}, 1))
    store.keep("y", Record({"a": picture(2)}, 2))
    (store.folder / "y.npz").write_bytes((store.folder / "x.npz").read_bytes())
    assert store.load("y") is None
    assert not (store.folder / "y.npz").exists()
    assert store.load("x").facts == 1


def test_no_pickle_is_ever_loaded(store, tmp_path):
    class Bomb:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "exploded"),)

    store.folder.mkdir(parents=True)
    facts = np.frombuffer(b'["x", null]', np.uint8)
    np.savez(store.folder / "x.npz", facts=facts, a=np.array([Bomb()], object))
    assert store.load("x") is None
    assert not (tmp_path / "exploded").exists()


def test_the_longest_unused_goes_first(tmp_path):
    size = picture(0).nbytes
    store = Store(tmp_path, 6 * size)
    for k in range(5):
        store.keep(str(k), Record({"a": picture(k)}))
        os.utime(tmp_path / f"{k}.npz", (1000 + k, 1000 + k))
    assert store.load("0") is not None  # of use again
    others = tmp_path / "notes.txt"
    others.write_text("not the store's")
    for k in range(5, 8):
        store.keep(str(k), Record({"a": picture(k)}))
    left = {k for k in range(8) if store.holds(str(k))}
    assert store.info().size_bytes <= 6 * size
    assert {0, 7} <= left
    assert not {1, 2} & left
    assert store.clear().records == len(left)
    assert store.info().records == 0
    assert others.exists()


def test_a_folder_that_takes_nothing_is_no_error(tmp_path):
    (tmp_path / "file").write_text("")
    store = Store(tmp_path / "file" / "store", 2**20)
    assert not store.keep("x", Record({"a": picture(1)}))
    assert store.load("x") is None
    store.remember_parts("t", {"a": "1"})
    assert store.last_parts("t") is None
    assert store.info().records == 0


def test_digests_differ_for_different_values():
    a = np.arange(6, dtype=np.float32)
    different = [a, a.reshape(2, 3), a.astype(np.float64), a + np.float32(1e-6), None]
    assert len({array_digest(x) for x in different}) == len(different)
    assert array_digest(a, None) != array_digest(None, a)
    assert array_digest(np.asfortranarray(a.reshape(2, 3))) == array_digest(a.reshape(2, 3))
    assert value_digest({"x": a}) == value_digest({"x": a.copy()})
    assert value_digest({"x": 1, "y": 2}) == value_digest({"y": 2, "x": 1})
    assert cache_address("p", {"a": "1"}) != cache_address("q", {"a": "1"})
    assert code_digest("render") != code_digest("display/lens")
    with pytest.raises(FileNotFoundError):
        code_digest("no_such_module.py")
    with pytest.raises(TypeError):
        value_digest(Path("decides nothing"))
