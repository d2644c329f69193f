"""EIAs of scenes, whose kernels are compiled while the scene is captured."""

import threading
import time
from pathlib import Path

import numpy as np

from inim.image.files.image import write_rgbd
from inim.image.rgbd import RGBD
from inim.pipeline import scene_capture

SCENE = Path(__file__).parents[2] / "scenes/jade.xml"


def test_a_scene_is_generated_after_the_first_call_that_compiles_kernels(monkeypatch):
    """Expected: one call at a time, because a generator has buffers for one picture."""
    picture = RGBD(np.ones((2, 2, 3)), np.zeros((2, 2)), np.ones((2, 2), bool), 0.5)
    busy, shapes = threading.Lock(), []

    def capture(job, make_request, folder, **_):
        make_request()
        with folder as place:
            write_rgbd(place / "rgbd.exr", picture)
            (place / "notes.json").write_text('{"imports": [], "warnings": []}', "utf-8")

    def run(handle, rgbd, *, holes=True):
        assert busy.acquire(blocking=False)
        shapes.append(rgbd.shape)
        time.sleep(0.3)
        busy.release()

    monkeypatch.setattr(scene_capture, "run_in_worker", capture)
    monkeypatch.setattr(scene_capture.GeneratorHandle, "run", run)
    scene_capture.generate_from_scene(SCENE, "nominal", {}, "template")
    assert len(shapes) == 2 and shapes[1] == picture.shape
