"""`inim generate PHOTO --estimate-depth MODEL`.

Expected: inverse depth is inverted, metres are kept, and without torch, transformers or the model
there is one line with the remedy. The model is a tiny one with random weights where torch and
transformers are installed, and otherwise a stand-in for the pipeline.
"""

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from inim.apps.own_picture import estimated_depth
from inim.apps.own_picture.estimated_depth import estimate_photo
from inim.cli.main import main
from inim.system.errors import EXIT_PASSED
from tests.system.conftest import assert_refused

SMALL = [word for name in ("columns", "rows") for word in ("-D", f"inim.lens_{name}=8")]


@pytest.fixture(autouse=True)
def no_loaded_model():
    estimated_depth._load_model.cache_clear()
    yield
    estimated_depth._load_model.cache_clear()


@pytest.fixture
def photo(tmp_path):
    path = tmp_path / "photo.png"
    pixels = np.random.default_rng(0).integers(0, 256, (42, 56, 3)).astype(np.uint8)
    Image.fromarray(pixels).save(path)
    return path


class _Tensor:
    """Tensor with the requested part only."""

    def __init__(self, values):
        self.values = np.asarray(values, np.float32)

    def detach(self):
        return self

    cpu = float = detach

    def numpy(self):
        return self.values


def stand_in(monkeypatch, message, **config):
    """Replace the pipeline of transformers by one with the output `message` for any picture."""
    inputs = []

    def pipeline(task, model):
        assert task == "depth-estimation"
        if isinstance(message, Exception):
            raise message

        def estimate(picture):
            inputs.append((model, picture.size))
            return {"predicted_depth": _Tensor(message)}

        estimate.model = SimpleNamespace(config=SimpleNamespace(**config))
        return estimate

    transformers = ModuleType("transformers")
    transformers.pipeline = pipeline
    monkeypatch.setitem(sys.modules, "transformers", transformers)
    monkeypatch.setitem(sys.modules, "torch", ModuleType("torch"))
    return inputs


def generate(photo, *more: str) -> int:
    words = ["generate", str(photo), *SMALL, "-o", str(photo.with_name("eia.png"))]
    return main([*words, "--estimate-depth", "mine", *more])


def test_inverse_depth_becomes_relative_distance(monkeypatch, photo):
    inverse = np.linspace(3, 11, 42 * 56).reshape(1, 42, 56)
    inputs = stand_in(monkeypatch, inverse, model_type="dpt")
    estimated = estimate_photo(photo, "mine")
    assert inputs == [("mine", (56, 42))]
    # Inverse distance is affine in the output: 1/4 at the least, 1 at the largest.
    np.testing.assert_allclose(
        1 / estimated.values.depth, 0.25 + 0.75 * (inverse[0] - 3) / 8, rtol=1e-5
    )
    assert not (estimated.values.near_is_large or estimated.values.has_unit)


def test_metres_are_kept_and_make_an_eia(monkeypatch, photo, capsys):
    metres = np.linspace(4, 1, 42)[:, None].repeat(56, 1)
    stand_in(monkeypatch, metres, model_type="depth_anything", depth_estimation_type="metric")
    assert generate(photo, "--fit", "cover", "--near", "1000", "--far", "4000") == EXIT_PASSED
    output = capsys.readouterr()
    assert "1000 (near) .. 4000 (far) mm" in output.out
    assert "depth estimated by mine: metres" in output.out
    assert output.err == ""
    assert photo.with_name("eia.png").exists()


def refuse(photo, *more: str, says: list[str]) -> None:
    words = ("generate", photo.name, "--estimate-depth", "mine", "-o", "eia.png")
    assert_refused(*words, *more, folder=photo.parent, says=says)


@pytest.mark.parametrize("missing", ["torch", "transformers"])
def test_without_the_extra_the_install_command_is_printed(photo, monkeypatch, missing):
    stand_in(monkeypatch, np.ones((4, 4)))
    monkeypatch.setitem(sys.modules, missing, None)
    refuse(photo, says=[f"{missing} is missing", "pip install 'inim[depth]'"])


@pytest.mark.parametrize(
    ("message", "says"),
    [
        (OSError("no local\nfolder"), "mine: failed on photo.png (no local folder)"),
        (np.full((4, 4), np.nan), "values not finite"),
        (np.ones((2, 3, 4, 5)), "shape (2, 3, 4, 5)"),
    ],
)
def test_a_model_that_cannot_be_used_is_named(photo, monkeypatch, message, says):
    stand_in(monkeypatch, message, model_type="dpt")
    refuse(photo, says=[says])


def test_a_tiny_model_from_a_folder(photo, tmp_path):
    """The real pipeline, with random weights."""
    pytest.importorskip("torch")
    transformers = pytest.importorskip("transformers")
    backbone = transformers.Dinov2Config(
        hidden_size=16, num_hidden_layers=4, num_attention_heads=2, image_size=28, patch_size=14,
        out_indices=[1, 2, 3, 4], apply_layernorm=True, reshape_hidden_states=False,
    )  # fmt: skip
    config = transformers.DepthAnythingConfig(
        backbone_config=backbone, patch_size=14, reassemble_hidden_size=16,
        neck_hidden_sizes=[4, 4, 8, 8], fusion_hidden_size=8, head_hidden_size=4,
    )  # fmt: skip
    folder = tmp_path / "tiny"
    transformers.DepthAnythingForDepthEstimation(config).save_pretrained(folder)
    size = {"height": 28, "width": 28}
    transformers.DPTImageProcessor(size=size, keep_aspect_ratio=False).save_pretrained(folder)
    depth = estimate_photo(photo, str(folder)).values.depth
    assert depth.shape == (42, 56)
    assert depth.min() == pytest.approx(1)
    assert depth.max() == pytest.approx(4)
