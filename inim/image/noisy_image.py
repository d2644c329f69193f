"""An image with its noise."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

# Estimates of the noise's second-order effect on SSIM take products of four independent images.
_LEAST_REPLICATES = 4
#: Replicates of a run's images. All have equally many, as estimates pair them.
REPLICATES = 8


def split_samples(spp: int) -> tuple[int, int]:
    """Number of independent parts of an image with `spp` samples per pixel, and samples of each.

    `REPLICATES` parts with at least `spp` samples together, or two halves if these are too few.
    """
    return (REPLICATES, -(-spp // REPLICATES)) if spp >= REPLICATES else (2, max(1, spp // 2))


def merged_mean(mean: np.ndarray, other: np.ndarray, share: float | np.ndarray) -> np.ndarray:
    """Mean of all samples from the means of two sets.

    `share` is the other set's share of the samples, for all pixels or (rows, columns, 1).
    """
    merged: np.ndarray = mean + np.float32(share) * (other - mean)
    return merged


def pseudo_values(whole: np.ndarray, without_each: Iterable[np.ndarray]) -> np.ndarray:
    """Jackknife pseudo-values of a function of K independent images, (K, ...).

    They average to its value for the mean image, without the bias of first order in the variance.

    * `whole`, (...): the function of the mean of all images.
    * `without_each`, K x (...): the function of the mean of all images but one.

    Source: Quenouille, Biometrika 43, 1956.
    """
    values = np.stack([*without_each])
    count = len(values)
    values *= 1 - count
    values += count * whole
    return values


@dataclass(frozen=True)
class NoisyImage:
    """An image with its noise, from two independent halves of its samples.

    The image is the mean of the halves, its noise is half their difference. A rendered image stores
    its halves, any other image stores itself and its noise. The other two follow, in float32: an
    8K panel takes 0.4 GB per array, so they are computed on each request. A view can have more than
    two independent parts, its replicates.
    """

    #: two (rows, columns, 3) float32, linear RGB: the halves, or the image and its noise. The noise
    #: is None for an image without noise.
    arrays: tuple[np.ndarray, np.ndarray | None]
    stores_halves: bool = False
    nonfinite: int = 0  #: Number of pixels that were not finite and are black instead.
    #: (K, rows, columns, 3) float32, linear RGB, K even and at least 4: independent images, whose
    #: mean is the image. The first K / 2 average to `first`, the others to `second`. Two images of
    #: a view may share noise, if they share it in replicates of equal index only.
    replicates: np.ndarray | None = None

    @classmethod
    def from_halves(cls, first: np.ndarray, second: np.ndarray) -> NoisyImage:
        """The mean of two halves."""
        return cls((first, second), stores_halves=True)

    @classmethod
    def from_image(
        cls,
        image: np.ndarray,
        noise: np.ndarray | None = None,
        replicates: np.ndarray | None = None,
    ) -> NoisyImage:
        """Image with noise; None means without noise."""
        return cls((image, noise), replicates=replicates)

    @classmethod
    def from_replicates(cls, replicates: np.ndarray) -> NoisyImage:
        """The mean of K independent images, (K, rows, columns, 3); see `replicates`."""
        count = len(replicates)
        if count < _LEAST_REPLICATES or count % 2:
            raise ValueError(
                f"{count} replicates of an image; give an even number, {_LEAST_REPLICATES} or more"
            )
        first, second = replicates.reshape(2, count // 2, *replicates.shape[1:]).mean(axis=1)
        return cls((first, second), stores_halves=True, replicates=replicates)

    @classmethod
    def from_parts(cls, parts: np.ndarray) -> NoisyImage:
        """The mean of two halves or of replicates, (parts, rows, columns, 3)."""
        return cls.from_halves(*parts) if len(parts) == 2 else cls.from_replicates(parts)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.arrays[0].shape[:2]
        return rows, columns

    @property
    def image(self) -> np.ndarray:
        """Mean of the halves, (rows, columns, 3) float32."""
        first, second = self.arrays
        if not self.stores_halves or second is None:
            return first
        mean: np.ndarray = first + second
        mean /= 2
        return mean

    @property
    def noise(self) -> np.ndarray | None:
        """Half of their difference, (rows, columns, 3) float32."""
        first, second = self.arrays
        if not self.stores_halves or second is None:
            return second
        half: np.ndarray = first - second
        half /= 2
        return half

    @property
    def first(self) -> np.ndarray:
        """The image from the first half of the samples."""
        return self.halves()[0]

    @property
    def second(self) -> np.ndarray:
        """The image from the second half of the samples."""
        return self.halves()[1]

    def halves(self, rows: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
        """Both halves, restricted to a band of rows."""
        image, noise = self.arrays[0][rows], self.arrays[1]
        if noise is None:
            return image, image
        if self.stores_halves:
            return image, noise[rows]
        return image + noise[rows], image - noise[rows]

    def merged(self, other: NoisyImage, share: float | np.ndarray) -> NoisyImage:
        """The image of all samples of two rendered images; see `merged_mean`."""
        first, second = (
            None if a is None or b is None else merged_mean(a, b, share)
            for a, b in zip(self.arrays, other.arrays, strict=True)
        )
        assert first is not None
        replicates = None
        if self.replicates is not None and other.replicates is not None:
            replicates = merged_mean(self.replicates, other.replicates, share)
        nonfinite = self.nonfinite + other.nonfinite
        return replace(self, arrays=(first, second), nonfinite=nonfinite, replicates=replicates)

    def replace_nonfinite(self) -> NoisyImage:
        """The same with black pixels where a stored half, or the image, is not finite."""
        if self.replicates is not None:
            replicates, count = replace_nonfinite(*self.replicates)
            # Finite replicates stay one array, which takes the most memory of a view.
            image = self.from_replicates(np.stack(replicates)) if count else self
            return replace(image, nonfinite=count)
        first, second = self.arrays
        if self.stores_halves and second is not None:
            (first, second), count = replace_nonfinite(first, second)
        else:
            (first,), count = replace_nonfinite(first)
            second = None if second is None else np.nan_to_num(second, posinf=0, neginf=0)
        return replace(self, arrays=(first, second), nonfinite=count)


@dataclass(frozen=True)
class NoisyEIA(NoisyImage):
    """An EIA with its noise, and its replicates where the views of a run observe it."""

    #: (K, pixels, 3) float32, linear RGB, K as of `replicates`: the observed panel pixels in
    #: reading order. None if unknown.
    observed: np.ndarray | None = None

    def merged(self, other: NoisyImage, share: float | np.ndarray) -> NoisyEIA:
        """See `NoisyImage`; where pixels are observed, the share is the largest."""
        assert isinstance(other, NoisyEIA)
        eia, observed = super().merged(other, share), None
        if self.observed is not None and other.observed is not None:
            observed = merged_mean(self.observed, other.observed, float(np.max(share)))
        return NoisyEIA(eia.arrays, eia.stores_halves, eia.nonfinite, observed=observed)

    def replace_nonfinite(self) -> NoisyEIA:
        """The same with black pixels where an array or a replicate is not finite."""
        eia, observed = super().replace_nonfinite(), self.observed
        if observed is not None:
            observed = np.stack(replace_nonfinite(*observed)[0])
        return NoisyEIA(eia.arrays, eia.stores_halves, eia.nonfinite, observed=observed)


def replace_nonfinite(*images: np.ndarray) -> tuple[list[np.ndarray], int]:
    """Images, (rows, columns, channels), with black nonfinite pixels, and the number of these."""
    if all(np.isfinite(image).all() for image in images):
        return list(images), 0
    wrong = [~np.isfinite(image).all(axis=-1) for image in images]
    replaced = [
        np.where(w[..., None], np.float32(0), image) if w.any() else image
        for w, image in zip(wrong, images, strict=True)
    ]
    return replaced, sum(int(np.count_nonzero(w)) for w in wrong)
