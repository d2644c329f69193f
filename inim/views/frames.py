"""Views for people to look at, as films and quilts hold them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from inim.display import Display, Viewpoint
from inim.image.color import srgb_codes
from inim.pipeline.stages.ground_truth import render_view
from inim.pipeline.stages.reconstruct import Optics, ShownEIA
from inim.pipeline.stages.scene import Renderer, Scene
from inim.pipeline.stages.stage import Run
from inim.views.traced_scene import TracedScene


def frames(
    source: np.ndarray | TracedScene,
    eyes: Iterable[Viewpoint],
    optics: Optics,
    design: Display,
    renderer: Renderer,
    stage: str,
) -> Iterator[np.ndarray]:
    """Views of an EIA through the lenses or of the scene itself, (rows, columns, 3) uint8 sRGB.

    Parameters
    ----------
    source : (rows, columns, 3) float32, or TracedScene
        An EIA in linear RGB, or the scene.
    eyes : iterable of Viewpoint
    optics : Optics
        A frame has half of its samples: one of its two halves of an EIA's view.
    design : Display
        As designed: the scene is fitted into its depth range.
    renderer : Renderer
    stage : str
        Name of the stage of each frame, for the progress bar.
    """
    if isinstance(source, TracedScene):
        scene = Scene(source.file(), design, source.fit_share, renderer)
    else:
        shown = ShownEIA(source, None, optics, renderer)
    for eye in eyes:
        renderer.observer.stage(stage)
        if isinstance(source, TracedScene):
            sampling = (optics.view_pixels_per_lens, optics.half_spp, 0)
            view = render_view(scene, eye, *sampling, run=Run())[0].image
        else:
            view = shown.view(eye, half=0)
        yield srgb_codes(view)
