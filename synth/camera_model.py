# SPDX-License-Identifier: GPL-3.0-or-later
"""A camera with the faults of a real one, each an option that is off by default.

In docs: docs/photos.md#faults-of-a-rendered-camera.

What the light passes through, in this order; x is exposure × radiance, each channel by itself:

    shutter    x ← x · 2^(σ z)           the picture's exposure is not quite the one that is stated
    lens       x ← x · v(r)              vignetting
    sensor     x ← noisy(x)              photons and electronics
    balance    x ← x · g                 the view's white balance
    local      x ← x · 2^G(pixel)        local tone mapping
    response   code = f(x), then 8 bit   synth/response.py

With all of them off a picture is exactly ``quantise(response(radiance * exposure))``. What is drawn at random
is left out of pictures that are held out (``CameraModel.systematic``). Numpy only.
"""

import argparse
import hashlib
from dataclasses import asdict, dataclass, fields, replace

import numpy as np

from ..bridge.contents import LUMINANCE
from .errors import OptionError
from .png import quantise
from .response import MIDDLE_GREY, Response

#: What middle grey is of saturation. ISO 12232: a meter gives 10 / S lux seconds, saturation is at 78 / S.
METERED_SHARE = 10 / 78
#: The exposure × radiance (1.404) at which the sensor would be full: the fixed point of its noise.
SATURATION = MIDDLE_GREY / METERED_SHARE
#: Electrons of a pixel at saturation and ISO 100; half of it for every doubling of the ISO. Measured: Canon
#: 5D Mark III 67,684, Canon 6D 79,546 (Magic Lantern's forum, topic 10111).
FULL_WELL = 68_000
#: Electrons, before the amplifier and after it, the latter at ISO 100: more gain makes it matter less.
#: Cameras lie between under 2 and about 15 (clarkvision.com, Sensor Performance Summary).
READ_NOISE, AMPLIFIED_READ_NOISE = 2.0, 6.0
#: Where numpy's Poisson sampler is safe; the noise is a part in 3e7 there.
MOST_ELECTRONS = 1e15

#: Of the picture's height: half the side of the windows in which the base layer looks for edges.
LOCAL_RADIUS = 0.08
#: Stops: what varies more than this within a window is an edge of the base, what varies less is detail.
LOCAL_CONTRAST = 0.5
#: Stops that local tone mapping brightens or darkens at most.
LOCAL_LIMIT = 3.0
#: Exposure × radiance that is added before the logarithm: what is darker is black to the camera.
LOCAL_BLACK = 2.0**-10

LIMITS = {
    "iso": (50.0, 409_600.0),
    "exposure_jitter": (0.0, 2.0),
    "white_balance_jitter": (0.0, 2.0),
    "vignetting": (0.0, 8.0),
    "local_response": (0.0, 1.0),
}

#: The faults that are drawn at random.
DRAWN = ("iso", "exposure_jitter", "white_balance_jitter")
#: What dataset.json says of test and validation pictures where there are such faults.
CLEAN_TRUTH = "nothing drawn: no noise, stated exposures exact, neutral white balance"


@dataclass(frozen=True, kw_only=True)
class CameraModel:
    """Which faults the camera has, and how much of them."""

    #: Photon and read noise of a sensor at this speed; ``None`` is a sensor without noise.
    iso: float | None = None
    #: Standard deviation in stops of a picture's exposure around the one that is stated.
    exposure_jitter: float = 0.0
    #: Standard deviation in stops of the red and the blue gain, drawn once a view; green keeps.
    white_balance_jitter: float = 0.0
    #: Stops that the picture's corners lose.
    vignetting: float = 0.0
    #: Strength 0…1 of local tone mapping: the share of the base layer's contrast that is taken away.
    local_response: float = 0.0

    @property
    def off(self) -> bool:
        """Whether this is the ideal camera."""
        return self == CameraModel()

    @property
    def systematic(self) -> "CameraModel":
        """The camera without what is drawn at random: it takes the pictures that methods are measured by.

        No method can predict what is drawn, so it would only hide how near a method comes.
        """
        return replace(self, **{name: getattr(CameraModel, name) for name in DRAWN})

    def check(self) -> None:
        """Raise ``OptionError`` for the first option that is out of range."""
        for name, (low, high) in LIMITS.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:  # also catches NaN
                raise OptionError(f"{_option(name)}: {value:g} is not within {low:g} … {high:g}")

    def describe(self) -> dict[str, object]:
        """The ``camera_model`` entry of dataset.json: what is on, with its constants; {} where all is off."""
        entry: dict[str, object] = {
            name: value for name, value in asdict(self).items() if value != getattr(CameraModel, name)
        }
        if self.iso is not None:
            entry["sensor"] = {
                "saturation": SATURATION,
                "electrons_at_saturation": electrons_at_saturation(self.iso),
                "read_noise_electrons": read_noise(self.iso),
            }
        if self.local_response:
            entry["local"] = {
                "radius": LOCAL_RADIUS,
                "contrast_stops": LOCAL_CONTRAST,
                "limit_stops": LOCAL_LIMIT,
            }
        if self.systematic != self:
            entry["held_out"] = CLEAN_TRUTH
        return entry

    def view(self, seed: int, name: str) -> "ViewCamera":
        """The camera as it is for the whole bracket of one view, such as ``train/r_3``."""
        return ViewCamera(self, seed, name)

    def develop(
        self,
        radiance: np.ndarray,
        exposure: float,
        response: Response,
        rng: np.random.Generator,
        balance: np.ndarray | None = None,
    ) -> np.ndarray:
        """Picture [H, W, 3] uint8 of radiance [H, W, 3] (scene-linear) truly exposed for ``exposure`` s.

        ``rng``: for the noise, not used without ``iso``. ``balance``: the view's gains [3], else neutral.
        """
        return quantise(self.code(self.sensed(radiance, exposure, rng), response, balance))

    def sensed(self, radiance: np.ndarray, exposure: float, rng: np.random.Generator) -> np.ndarray:
        """The sensor's reading [H, W, 3] of radiance that was truly exposed for ``exposure`` s.

        It is full at ``SATURATION``; nothing is clipped there yet.
        """
        x = radiance * exposure
        if self.vignetting:
            x = x * vignette(*x.shape[:2], self.vignetting)[..., None]
        return x if self.iso is None else noisy(x, self.iso, rng)

    def code(self, x: np.ndarray, response: Response, balance: np.ndarray | None = None) -> np.ndarray:
        """Code values [H, W, 3] in 0…1 that the camera makes of what its sensor counted."""
        if balance is not None:
            x = x * balance
        if self.local_response:
            x = x * np.exp2(local_stops(x, self.local_response))[..., None]
        return response(x)


@dataclass(frozen=True)
class ViewCamera:
    """The camera for one view. One seed and name give the same pictures, in whatever order they are made."""

    model: CameraModel
    seed: int
    name: str

    @property
    def balance(self) -> np.ndarray:
        """White balance gains [3]: 2^(σ z) for red and blue with z standard normal, 1 for green."""
        red, blue = self._rng("white balance").normal(0.0, self.model.white_balance_jitter, 2)
        return np.exp2([red, 0.0, blue])

    def true_exposure(self, stated: float) -> float:
        """Seconds that a picture is exposed for in truth: those stated · 2^(σ z), z standard normal."""
        stops = self._rng(f"exposure of {stated:.9g} s").normal(0.0, self.model.exposure_jitter)
        return stated * float(np.exp2(stops))

    def develop(self, radiance: np.ndarray, exposure: float, response: Response) -> np.ndarray:
        """Picture [H, W, 3] uint8 of radiance [H, W, 3]; every exposure has noise and error of its own."""
        return self.model.develop(
            radiance, self.true_exposure(exposure), response, self._noise(exposure), self._balance
        )

    def code(self, radiance: np.ndarray, exposure: float, response: Response) -> np.ndarray:
        """The same before it is 8 bit: code values in 0…1."""
        return self.model.code(self.sensed(radiance, exposure), response, self._balance)

    def sensed(self, radiance: np.ndarray, exposure: float) -> np.ndarray:
        """The sensor's reading [H, W, 3], with the picture's own noise and error of exposure."""
        return self.model.sensed(radiance, self.true_exposure(exposure), self._noise(exposure))

    @property
    def _balance(self) -> np.ndarray | None:
        return self.balance if self.model.white_balance_jitter else None

    def _noise(self, exposure: float) -> np.random.Generator:
        return self._rng(f"{exposure:.9g} s")

    def _rng(self, purpose: str) -> np.random.Generator:
        digest = hashlib.sha256(f"{self.seed}/{self.name}/{purpose}".encode()).digest()
        return np.random.default_rng(int.from_bytes(digest[:16], "little"))


# ---- command line ------------------------------------------------------------------------------------


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options as a group of their own."""
    add = parser.add_argument_group("a real camera (all off by default; docs/photos.md)").add_argument
    add(
        "--iso", type=float, metavar="S", help="photon and read noise of a sensor at this speed, such as 3200"
    )
    add(
        "--exposure-jitter",
        type=float,
        default=CameraModel.exposure_jitter,
        metavar="STOPS",
        help="standard deviation of each picture's exposure around the one that is stated, such as 0.05",
    )
    add(
        "--white-balance-jitter",
        type=float,
        default=CameraModel.white_balance_jitter,
        metavar="STOPS",
        help="standard deviation of each view's red and blue gain, such as 0.1",
    )
    add(
        "--vignetting",
        type=float,
        default=CameraModel.vignetting,
        metavar="STOPS",
        help="what the corners lose, such as 1.5",
    )
    add(
        "--local-response",
        type=float,
        default=CameraModel.local_response,
        metavar="0…1",
        help="strength of local tone mapping, as phones do it, such as 0.6",
    )


def from_arguments(args: argparse.Namespace) -> CameraModel:
    """The camera that was asked for; not checked yet."""
    return CameraModel(**{field.name: getattr(args, field.name) for field in fields(CameraModel)})


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")


# ---- lens --------------------------------------------------------------------------------------------


def vignette(height: int, width: int, corner_stops: float) -> np.ndarray:
    """Share of the light [height, width] that arrives: the cos⁴ law, cos⁴θ = (1 + tan²θ)⁻².

    v(r) = (1 + (2^(L/2) − 1) r²)⁻², r = distance from the picture's centre over that of its corner; so v is 1
    in the centre and 2^−L in the corner, whatever the field of view.
    """
    y = (np.arange(height) + 0.5 - height / 2)[:, None]
    x = (np.arange(width) + 0.5 - width / 2)[None, :]
    r2 = (x**2 + y**2) / (width**2 / 4 + height**2 / 4)
    return (1.0 + (2.0 ** (corner_stops / 2) - 1.0) * r2) ** -2


# ---- sensor ------------------------------------------------------------------------------------------


def electrons_at_saturation(iso: float) -> float:
    """Electrons of a pixel where exposure × radiance is ``SATURATION``: the full well at ISO 100."""
    return FULL_WELL * 100.0 / iso


def read_noise(iso: float) -> float:
    """Standard deviation in electrons: √(2² + (6 · 100 / S)²)."""
    return float(np.hypot(READ_NOISE, AMPLIFIED_READ_NOISE * 100.0 / iso))


def noisy(x: np.ndarray, iso: float, rng: np.random.Generator) -> np.ndarray:
    """x as a sensor reads it: n = x · N / x_s electrons, read as (Poisson(n) + σ z) · x_s / N.

    N = ``electrons_at_saturation(iso)``, x_s = ``SATURATION``, σ = ``read_noise(iso)``, z standard normal.
    Mean x, variance x · x_s / N + (σ x_s / N)². Above x_s the well does not overflow: the response says where
    white is. May be negative by the read noise; the response takes that for black.
    """
    per_unit = electrons_at_saturation(iso) / SATURATION
    photons = rng.poisson(np.clip(x * per_unit, 0.0, MOST_ELECTRONS))
    return (photons + rng.normal(0.0, read_noise(iso), x.shape)) / per_unit


# ---- local tone mapping ------------------------------------------------------------------------------


def local_stops(x: np.ndarray, strength: float) -> np.ndarray:
    """Exposure gain in stops [H, W] of local tone mapping of x [H, W, 3].

    G = clip(−strength · (B − mean B), ± ``LOCAL_LIMIT``). B is the base of ℓ = log2(Y + ``LOCAL_BLACK``) with
    Y the luminance: ℓ smoothed but for its edges. So dark regions are lifted and bright ones held back,
    what is small in them keeps its contrast, and the picture keeps its mean. A longer exposure changes G only
    as it lifts shadows out of the black.
    """
    luminance = np.maximum(x @ LUMINANCE, 0.0)
    base = edge_preserving(np.log2(luminance + LOCAL_BLACK), max(1, round(LOCAL_RADIUS * x.shape[0])))
    return np.clip(-strength * (base - base.mean()), -LOCAL_LIMIT, LOCAL_LIMIT)


def edge_preserving(image: np.ndarray, radius: int) -> np.ndarray:
    """[H, W] smoothed but for edges: the guided filter with itself as guide (He, Sun and Tang 2013).

    In every window of 2 radius + 1 pixels it fits a · image + b with a = variance / (variance + contrast²).
    """
    mean = box_mean(image, radius)
    variance = np.maximum(box_mean(image**2, radius) - mean**2, 0.0)
    slope = variance / (variance + LOCAL_CONTRAST**2)
    return box_mean(slope, radius) * image + box_mean((1.0 - slope) * mean, radius)


def box_mean(image: np.ndarray, radius: int) -> np.ndarray:
    """Mean over the window of ±radius pixels, at the border over the part of it within the picture."""
    for axis in (0, 1):
        length = image.shape[axis]
        total = np.concatenate([np.zeros_like(image.take([0], axis)), np.cumsum(image, axis)], axis)
        low = np.maximum(np.arange(length) - radius, 0)
        high = np.minimum(np.arange(length) + radius + 1, length)
        count = (high - low).reshape((-1, 1) if axis == 0 else (1, -1))
        image = (total.take(high, axis) - total.take(low, axis)) / count
    return image
