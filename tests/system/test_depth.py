"""`inim depth`: an outline or a model gives depth that `inim generate` takes.

Expected: inverse depth is turned round, metres are kept, and without torch, transformers or the
model there is one line with the way out. The model is a tiny one with random weights where torch
and transformers are installed, and otherwise a stand-in for the pipeline.
"""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from inim.cli import main
from inim.commands.inputs import relative_distance, returns_distance
from inim.errors import EXIT_PASSED, UsageError
from inim.from_camera.picture_files import read_depth
from tests.system.conftest import assert_refused

MODEL = ("depth", "--method", "model")


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
    """Put a pipeline in place of transformers' that says `said` of any picture."""
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


def test_inverse_depth_is_turned_round(monkeypatch, photo, capsys):
    inverse = np.linspace(3, 11, 42 * 56).reshape(1, 42, 56)
    inputs = stand_in(monkeypatch, inverse, model_type="dpt")
    out = photo.with_name("d.exr")
    assert main([*MODEL, str(photo), "-o", str(out), "--depth-ratio", "5"]) == EXIT_PASSED
    assert inputs == [("depth-anything/Depth-Anything-V2-Small-hf", (56, 42))]
    depth = read_depth(out).values
    assert depth.shape == (42, 56)
    # Inverse distance is affine in what was said: 1/5 at the least, 1 at the largest.
    np.testing.assert_allclose(1 / depth, 0.2 + 0.8 * (inverse[0] - 3) / 8, rtol=1e-5)
    assert "--depth-unit none --far-is-large" in capsys.readouterr().out


def test_metres_are_kept_and_make_an_eia(monkeypatch, photo, capsys):
    metres = np.linspace(4, 1, 42)[:, None].repeat(56, 1)
    stand_in(monkeypatch, metres, model_type="depth_anything", depth_estimation_type="metric")
    out, eia = photo.with_name("d.npy"), photo.with_name("eia.png")
    assert main([*MODEL, str(photo), "-o", str(out)]) == EXIT_PASSED
    np.testing.assert_allclose(read_depth(out).values, metres, rtol=1e-6)
    use = capsys.readouterr().out.split("next       inim ")[1].split()
    size = [w for k in ("columns", "rows") for w in ("-D", f"inim.lens_{k}=8")]
    assert main([*use, *size, "-o", str(eia)]) == EXIT_PASSED
    output = capsys.readouterr()
    assert "1000 (near) .. 4000 (far) mm" in output.out
    assert output.err == ""


def test_flat_inverse_depth_is_all_near():
    assert (relative_distance(np.full((3, 4), 7.0), 4.0) == 1).all()


def test_a_model_s_output_follows_from_its_kind_or_an_option():
    def config(kind, **more):
        return SimpleNamespace(model_type=kind, **more)

    assert returns_distance(config("zoedepth"), "m")
    assert not returns_distance(config("dpt"), "m")
    assert not returns_distance(config("depth_anything", depth_estimation_type="relative"), "m")
    assert returns_distance(config("dpt"), "m", "metres")
    with pytest.raises(UsageError, match="--model-output inverse"):
        returns_distance(config("odd"), "m")


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (("-o", "d.png"), "-o d.png"),
        (("-o", "d.exr", "--depth-ratio", "1"), "--depth-ratio 1"),
        (("-o", "d.exr", "--model-output", "feet"), "--model-output feet"),
    ],
)
def test_a_mistake_is_one_line(photo, more, says):
    assert_refused(*MODEL, photo.name, *more, folder=photo.parent, says=[says])


def test_a_folder_named_as_the_default_model_does_not_replace_it(photo, monkeypatch):
    (photo.parent / "depth-anything/Depth-Anything-V2-Small-hf").mkdir(parents=True)
    stand_in(monkeypatch, np.ones((4, 4)), model_type="dpt")
    says = ["give --model ./depth-anything"]
    assert_refused(*MODEL, photo.name, "-o", "d.exr", folder=photo.parent, says=says)


@pytest.mark.parametrize("missing", ["torch", "transformers"])
def test_without_the_extra_the_install_command_is_printed(photo, monkeypatch, missing):
    stand_in(monkeypatch, np.ones((4, 4)))
    monkeypatch.setitem(sys.modules, missing, None)
    says = [f"{missing} is missing", "pip install 'inim[depth]'"]
    assert_refused(*MODEL, photo.name, "-o", "d.exr", folder=photo.parent, says=says)


@pytest.mark.parametrize(
    ("message", "says"),
    [
        (OSError("mine is no local folder\nand more"), "--model mine: cannot be loaded (mine is"),
        (np.full((4, 4), np.nan), "values not finite"),
        (np.ones((2, 3, 4, 5)), "shape (2, 3, 4, 5)"),
    ],
)
def test_a_model_that_cannot_be_used_is_named(photo, monkeypatch, message, says):
    stand_in(monkeypatch, message, model_type="dpt")
    words = (photo.name, "-o", "d.exr", "--model", "mine")
    assert_refused(*MODEL, *words, folder=photo.parent, says=[says])


def test_a_tiny_model_from_a_folder(photo, tmp_path, capsys):
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
    out = tmp_path / "d.exr"
    assert main([*MODEL, str(photo), "-o", str(out), "--model", str(folder)]) == EXIT_PASSED
    depth = read_depth(out).values
    assert depth.shape == (42, 56)
    assert depth.min() == pytest.approx(1)
    assert depth.max() == pytest.approx(4)
    assert "inverse depth" in capsys.readouterr().out


@pytest.fixture
def jar(tmp_path):
    """Photograph of a striped disc of 60 pixels' radius before a background that brightens."""
    y, x = np.mgrid[:200, :240]
    color = 90 + 60 * (x[..., None] / 240) ** 2 + np.array([0, 4, 9])
    color = color + np.random.default_rng(1).normal(0, 1.5, color.shape)
    disc = (x - 130) ** 2 + (y - 90) ** 2 < 60**2
    color[disc & (y // 8 % 2 == 0)] = (170, 60, 30)
    color[disc & (y // 8 % 2 == 1)] = (20, 20, 25)
    path = tmp_path / "jar.png"
    Image.fromarray(color.astype(np.uint8)).save(path)
    return path, disc


@pytest.mark.parametrize("ending", ["exr", "npy", "png"])
def test_a_disc_becomes_a_hemisphere(jar, capsys, ending):
    path, disc = jar
    out = path.with_name(f"d.{ending}")
    assert main(["depth", str(path), "-o", str(out)]) == EXIT_PASSED
    values = read_depth(out).values.astype(float)
    nearness = values / (65535 if ending == "png" else 1)
    assert (disc == (nearness > 0)).mean() > 0.995
    y, x = np.mgrid[:200, :240]
    height = np.sqrt(np.maximum(1 - ((x - 130) ** 2 + (y - 90) ** 2) / 60**2, 0))
    inside = height > 0.4
    np.testing.assert_allclose(nearness[inside], 0.25 + 0.75 * height[inside], atol=0.03)
    use = capsys.readouterr().out.split("next       inim ")[1].split()
    eia = path.with_name("eia.png")
    size = [w for k in ("columns", "rows") for w in ("-D", f"inim.lens_{k}=8")]
    assert main([*use, *size, "-o", str(eia)]) == EXIT_PASSED
    assert eia.exists() and capsys.readouterr().err == ""


def test_a_bar_cut_by_the_edge_becomes_a_half_cylinder(photo):
    mask = np.zeros((42, 56), np.uint8)
    mask[:, 18:38] = 255
    Image.fromarray(mask).save(photo.with_name("mask.png"))
    words = ["-o", str(photo.with_name("d.npy")), "--mask", str(photo.with_name("mask.png"))]
    assert main(["depth", str(photo), *words]) == EXIT_PASSED
    nearness = np.load(photo.with_name("d.npy"))
    across = (np.arange(18, 38) - 27.5) / 10.5
    profile = np.sqrt(1 - across**2)
    expected = 0.25 + 0.75 * profile / profile.max()
    np.testing.assert_allclose(nearness[:, 18:38], expected[None].repeat(42, 0), atol=1e-5)
    assert not nearness[:, :18].any()
    assert main(["depth", str(photo), *words, "--method", "layers"]) == EXIT_PASSED
    np.testing.assert_array_equal(np.load(photo.with_name("d.npy")), mask / 255)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ((), "--mask FILE"),
        (("--mask", "small.png"), "4 x 3 pixels"),
        (("--method", "shading"), "--method"),
        (("--model", "mine"), "--method model"),
    ],
)
def test_without_an_outline_the_way_out_is_one_line(photo, more, says):
    Image.new("L", (4, 3), 255).save(photo.with_name("small.png"))
    assert_refused("depth", photo.name, "-o", "d.exr", *more, folder=photo.parent, says=[says])
