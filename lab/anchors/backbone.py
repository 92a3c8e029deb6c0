# SPDX-License-Identifier: GPL-3.0-or-later
"""Scaffold-GS's backbone: anchors with features, from which networks make k Gaussians each for every view.

Written from the facts in lab/peers.md (Lu et al., Scaffold-GS, CVPR 2024). The colour network gives
ln H_r, without a sigmoid; illumination, shares of light and context do not know the viewing direction.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import nn

from ...backend.model.backbone import Attributes, Backbone, Splats, Start
from ...backend.model.gaussians import Gaussians
from ...backend.model.morton import morton_order
from ...backend.model.rates import Rate
from ...backend.scene.camera import Camera
from ...backend.scene.resident import camera_tensors
from ...bridge.errors import BadValueError
from ...bridge.spherical_harmonics import fibonacci_sphere
from ...bridge.splatting import LOW_PASS, NEAR_PLANE
from .config import VOXELS_PER_SPACING, AnchorsConfig
from .harmonics_fit import HarmonicsFit
from .networks import DIRECTION, Head, run_heads

#: Splats reach this many standard deviations; beyond it an anchor's ellipsoid does not count as seen.
REACH = 3.0
#: ln of the largest size of an anchor's Gaussians (Scaffold-GS, in the units of its reconstructions; ours are
#: metres, so that it is 1.05 m there). It is applied where anchors grow.
LARGEST_LOG_SCALE = 0.05
#: Directions from which new anchors must not be blank (3° apart), …
DIRECTIONS_AROUND = 4096
#: … and what tanh⁻¹ of the largest opacity of their Gaussians is raised to, from everywhere, where they would
#: be: what it is at its least in a usual draw of the network.
LEAST_OPACITY_LOGIT = 0.1
#: Anchors that are fixed at once: the normal equations of k Gaussians each fit into memory.
FIXED_AT_ONCE = 4096
#: Weight of a Gaussian that a view has switched off: its colour there says little, but more than nothing.
LEAST_WEIGHT = 1e-3
#: Opacities are kept this far from 0 and 1, where their logits end.
OPACITY_MARGIN = 1e-4


@dataclass(frozen=True)
class AnchorSplats(Splats):
    """The neural Gaussians with opacity above 0, and where they come from.

    ``seen`` ``[V]`` int64: the anchors in the frustum. ``drawn`` ``[M]`` int64, ascending: the Gaussians
    drawn, among the V·k of the anchors seen. ``opacity_sum`` ``[V]``: of all k, negative ones as 0.
    """

    seen: torch.Tensor = field(kw_only=True)
    drawn: torch.Tensor = field(kw_only=True)
    opacity_sum: torch.Tensor = field(kw_only=True)


class Anchors(Backbone):
    """N anchors with k Gaussians each; every tensor is a leaf that requires a gradient.

    =====================  ==========  ===============================================================
    ``anchors``            [N, 3]      metres; never moves
    ``offsets``            [N, k, 3]   of the Gaussians, in units of exp(``log_scaling[:, :3]``)
    ``features``           [N, F]      what the networks read
    ``log_scaling``        [N, 6]      ln of the offsets' unit and of the Gaussians' largest scales, metres
    ``base_log_radiance``  [N, 3]      only with ``base_radiance``
    =====================  ==========  ===============================================================

    ``networks``: ``opacity``, ``covariance``, ``colour``, ``illumination``; ``light_share`` and ``context``
    if the method needs them. Those names are also the groups that have learning rates.
    """

    def __init__(self, config: AnchorsConfig, attributes: Attributes) -> None:
        if attributes.direction_gradient:
            raise BadValueError(
                "anchors never move, so that nothing could follow the gradient of the direction to them",
                "Leave out --set method.direction_gradient, or take a preset without '-scaffold'.",
            )
        self.config, self.attributes = config, attributes
        self.parameters: dict[str, torch.Tensor] = {}
        #: ε, metres; known once anchors are placed.
        self.voxel_size = config.voxel_size
        k, feature, hidden = config.offsets, config.feature_size, config.hidden
        seen_from = feature + DIRECTION
        self.networks = nn.ModuleDict(
            {
                "opacity": Head(seen_from, hidden, k),
                "covariance": Head(seen_from, hidden, 7 * k),
                "colour": Head(seen_from, hidden, 3 * k, starts_at_zero=config.base_radiance),
                "illumination": Head(
                    feature, hidden, attributes.illumination_channels * k, starts_at_zero=True
                ),
            }
        )
        if attributes.lights:
            shares = attributes.lights * 3 * k
            self.networks["light_share"] = Head(feature, hidden, shares, starts_at_zero=True)
        if attributes.context_size:
            self.networks["context"] = nn.Linear(feature, attributes.context_size, bias=False)

    @property
    def positions(self) -> torch.Tensor:
        return self.parameters["anchors"]

    @property
    def gaussian_count(self) -> int:
        return len(self) * self.config.offsets

    def rates(self) -> dict[str, Rate]:
        return self.config.rates.by_group()

    def shapes(self) -> dict[str, tuple[int, ...]]:
        shapes: dict[str, tuple[int, ...]] = {
            "anchors": (3,),
            "offsets": (self.config.offsets, 3),
            "features": (self.config.feature_size,),
            "log_scaling": (6,),
        }
        if self.config.base_radiance:
            shapes["base_log_radiance"] = (3,)
        return shapes

    def place(self, positions: np.ndarray, log_radiance: np.ndarray, start: Start) -> None:
        """One anchor in every cell that has a point, as large as the distance to its neighbours.

        ``start`` has no effect here: opacity is a network's, whose bias is raised where a view would see
        nothing of the anchors.
        """
        spacing = _neighbour_distance(positions)
        self.voxel_size = self.config.voxel_size
        if self.voxel_size <= 0:
            self.voxel_size = float(np.median(spacing)) / VOXELS_PER_SPACING
        cell = self.voxel_size * self.config.placement
        cells, member, members = np.unique(
            np.round(positions / cell), axis=0, return_inverse=True, return_counts=True
        )
        anchors = cells * cell
        sums = np.zeros((len(cells), 3))
        np.add.at(sums, member.reshape(-1), log_radiance)
        order = morton_order(torch.as_tensor(anchors)).numpy()
        anchors, radiance = anchors[order], (sums / members[:, None])[order]
        log_size = np.log(_neighbour_distance(anchors))
        count, k = len(anchors), self.config.offsets
        parameters = {
            "anchors": torch.tensor(anchors, dtype=torch.float32),
            "offsets": torch.zeros(count, k, 3),
            "features": torch.zeros(count, self.config.feature_size),
            "log_scaling": torch.tensor(log_size, dtype=torch.float32)[:, None].repeat(1, 6),
        }
        if self.config.base_radiance:
            parameters["base_log_radiance"] = torch.tensor(radiance, dtype=torch.float32)
        self.parameters = {name: tensor.requires_grad_() for name, tensor in parameters.items()}
        self._show_from_everywhere()

    @torch.no_grad()
    def _show_from_everywhere(self) -> None:
        """Raise the opacities of a draw of the network that shows nothing of new anchors from some direction.

        New anchors' features are 0, so that the direction alone says which of their Gaussians are drawn. From
        where none is, none has a gradient, and the anchors stay blank. One draw in eight with k = 5 is such.
        """
        head = self.networks["opacity"]
        assert isinstance(head, Head)
        directions = torch.from_numpy(fibonacci_sphere(DIRECTIONS_AROUND)).to(head.w1)
        nothing = directions.new_zeros(DIRECTIONS_AROUND, self.config.feature_size)
        faintest = head(torch.cat([nothing, directions], dim=1)).amax(1).min()
        if faintest <= 0.0:
            head.b2 += LEAST_OPACITY_LOGIT - faintest

    @torch.no_grad()
    def in_frustum(self, camera: Camera) -> torch.Tensor:
        """``[V]`` int64: the anchors whose ellipsoids (unrotated) have a footprint on the screen."""
        tensors = camera_tensors(camera, self.positions)
        rotation, (fx, _, cx), (_, fy, cy) = tensors.view[:3, :3], *tensors.intrinsics[:2]
        variance = (2.0 * self.parameters["log_scaling"][:, :3]).exp()
        x, y, depth = (self.positions @ rotation.T + tensors.view[:3, 3]).unbind(1)
        z = depth.clamp_min(NEAR_PLANE)
        x, y = x / z, y / z
        # Rows of the projection's Jacobian times the rotation, so Σ_xx = Σ_i across_i² s_i² + low pass.
        across = (fx / z)[:, None] * (rotation[0] - x[:, None] * rotation[2])
        down = (fy / z)[:, None] * (rotation[1] - y[:, None] * rotation[2])
        reach_x = REACH * ((across * across * variance).sum(1) + LOW_PASS).sqrt()
        reach_y = REACH * ((down * down * variance).sum(1) + LOW_PASS).sqrt()
        column, row = fx * x + cx, fy * y + cy
        seen = (depth > NEAR_PLANE) & (column + reach_x > 0) & (column - reach_x < camera.width)
        seen &= (row + reach_y > 0) & (row - reach_y < camera.height)
        return seen.nonzero().squeeze(1)

    def outputs(self, seen: torch.Tensor, directions: torch.Tensor) -> dict[str, torch.Tensor]:
        """The networks' outputs for the anchors ``seen`` ``[V]`` from unit ``directions`` ``[V, 3]``.

        ``opacity`` ``[V·k]`` in (−1, 1), ``covariance`` ``[V·k, 7]``, ``colour`` ``[V·k, 3]``,
        ``illumination`` ``[V·k, 1 or 3]``, ``light_share`` ``[V·k, C·3]``, and ``context`` ``[V, K]``.
        """
        features = self.parameters["features"].index_select(0, seen)
        heads = {name: head for name, head in self.networks.items() if isinstance(head, Head)}
        values = run_heads(list(heads.values()), torch.cat([features, directions], dim=1))
        rows = seen.shape[0] * self.config.offsets
        outputs = {
            name: value.reshape(rows, value.shape[1] // self.config.offsets)
            for name, value in zip(heads, values, strict=True)
        }
        outputs["opacity"] = outputs["opacity"].squeeze(1).tanh()
        if "context" in self.networks:
            outputs["context"] = self.networks["context"](features)
        return outputs

    def splats(self, camera: Camera, sh_degree: int) -> AnchorSplats:
        """Only of the anchors in the frustum, and only Gaussians whose opacity is above 0."""
        seen = self.in_frustum(camera)
        position = camera_tensors(camera, self.positions).position
        directions = nn.functional.normalize(self.positions.detach().index_select(0, seen) - position, dim=1)
        outputs = self.outputs(seen, directions)
        opacities = outputs["opacity"].detach()
        drawn = (opacities > 0).nonzero().squeeze(1)
        opacity_sum = opacities.clamp_min(0.0).reshape(-1, self.config.offsets).sum(1)
        return self.neural_gaussians(outputs, seen, drawn, opacity_sum)

    def neural_gaussians(
        self,
        outputs: dict[str, torch.Tensor],
        seen: torch.Tensor,
        drawn: torch.Tensor,
        opacity_sum: torch.Tensor,
    ) -> AnchorSplats:
        """The Gaussians ``drawn`` ``[M]`` from the ``outputs`` for the anchors ``seen``.

        mean = anchor + offset · exp(scaling₁), scales = exp(scaling₂) · sigmoid(m₁₋₃), rotation = m₄₋₇.
        """
        k = self.config.offsets
        row = drawn.div(k, rounding_mode="floor")
        anchor = seen.index_select(0, row)
        offsets = self.parameters["offsets"].flatten(0, 1).index_select(0, anchor * k + drawn - row * k)
        scaling = self.parameters["log_scaling"].exp().index_select(0, anchor)
        shape = outputs["covariance"].index_select(0, drawn)
        colour = outputs["colour"].index_select(0, drawn)
        if self.config.base_radiance:
            colour = colour + self.parameters["base_log_radiance"].index_select(0, anchor)
        share = outputs.get("light_share")
        context = outputs.get("context")
        return AnchorSplats(
            means=self.positions.detach().index_select(0, anchor) + offsets * scaling[:, :3],
            quaternions=shape[:, 3:],
            scales=scaling[:, 3:] * shape[:, :3].sigmoid(),
            opacities=outputs["opacity"].index_select(0, drawn),
            log_reflectance=colour,
            log_illumination=outputs["illumination"].index_select(0, drawn),
            light_share=None if share is None else self._shares(share.index_select(0, drawn)),
            context=None if context is None else context.index_select(0, row),
            seen=seen,
            drawn=drawn,
            opacity_sum=opacity_sum,
        )

    def _shares(self, logits: torch.Tensor) -> torch.Tensor:
        """As ``Gaussians.light_share``, from logits ``[M, C·3]``: a softmax with what no light turns."""
        logits = logits.reshape(-1, self.attributes.lights, 3)
        if self.attributes.lights == 1:
            return logits.sigmoid()
        return nn.functional.pad(logits, (0, 0, 0, 1)).softmax(dim=1)[:, :-1]

    def regulariser(self, splats: Splats) -> torch.Tensor | None:
        """Scaffold-GS's: the mean volume of what is drawn, weighted."""
        if not self.config.volume_weight:
            return None
        volumes = splats.scales.prod(dim=1)
        return self.config.volume_weight * volumes.sum() / max(volumes.shape[0], 1)

    # -- fixed -------------------------------------------------------------------------------------------

    @torch.no_grad()
    def fixed(self, cameras: Sequence[Camera]) -> Gaussians:
        """Plain Gaussians that look as similar as possible to ``cameras``; none: ``BadValueError``.

        Opacity and covariance are those of the mean viewing direction of the cameras that have the anchor in
        their picture; ln H_r is fitted to what the network says in the directions that they really see it
        from, weighted by the opacity there; illumination, shares of light and context have no direction and
        stay. What no camera sees is omitted. Lost are opacities and shapes that change with the direction
        (lab/notebook.md says what that costs), and details finer than the harmonics.
        """
        if not cameras:
            raise BadValueError("anchors can only be fixed for cameras", "Give the training cameras.")
        visible = torch.zeros(len(cameras), len(self), dtype=torch.bool, device=self.positions.device)
        for flags, camera in zip(visible, cameras, strict=True):
            flags[self.in_frustum(camera)] = True
        some = visible.any(dim=0).nonzero().squeeze(1)
        if not len(some):
            raise BadValueError("none of the cameras sees an anchor", "Give the training cameras.")
        parts = [self._fixed(cameras, visible, chunk) for chunk in some.split(FIXED_AT_ONCE)]
        return Gaussians(
            {name: torch.cat([part[name] for part in parts]).requires_grad_() for name in parts[0]},
            self.attributes,
        )

    def _fixed(
        self, cameras: Sequence[Camera], visible: torch.Tensor, chunk: torch.Tensor
    ) -> dict[str, torch.Tensor]:
        """Parameters of the Gaussians of the anchors ``chunk`` ``[A]``, each seen by a camera."""
        k, positions = self.config.offsets, self.positions[chunk]
        viewpoints = [camera_tensors(camera, positions).position for camera in cameras]
        directions = torch.stack(
            [nn.functional.normalize(positions - viewpoint, dim=1) for viewpoint in viewpoints]
        )
        mean_direction = nn.functional.normalize((directions * visible[:, chunk, None]).sum(0), dim=1)
        outputs = self.outputs(chunk, mean_direction)
        drawn = (outputs["opacity"] > 0).nonzero().squeeze(1)
        splats = self.neural_gaussians(outputs, chunk, drawn, outputs["opacity"].new_zeros(len(chunk)))
        base = self.parameters.get("base_log_radiance")
        base = positions.new_zeros(len(chunk), 3) if base is None else base[chunk]

        fit = HarmonicsFit(splats.means, self.attributes.sh_degree)
        for c, viewpoint in enumerate(viewpoints):
            # The networks have a colour for every anchor; views without it in their picture weigh nothing.
            here = self.outputs(chunk, directions[c])
            weight = here["opacity"][drawn].clamp_min(LEAST_WEIGHT) * visible[c, chunk][drawn // k]
            fit.add(viewpoint, here["colour"][drawn] + base[drawn // k], weight)
        coefficients = fit.solved()

        parameters = {
            "means": splats.means,
            "log_scales": splats.scales.log(),
            "quaternions": nn.functional.normalize(splats.quaternions, dim=1),
            "opacity_logits": splats.opacities.clamp(OPACITY_MARGIN, 1.0 - OPACITY_MARGIN).logit(),
            "reflectance_dc": coefficients[:, :1],
            "reflectance_rest": coefficients[:, 1:],
            "log_illumination": splats.log_illumination,
        }
        if "light_share" in outputs:
            parameters["light_share_logits"] = outputs["light_share"][drawn].reshape(len(drawn), -1, 3)
        if splats.context is not None:
            parameters["context"] = splats.context
        return {name: tensor.contiguous() for name, tensor in parameters.items()}


def _neighbour_distance(points: np.ndarray) -> np.ndarray:
    """Root mean square distance ``[P]`` to the three nearest neighbours; few: ``BadValueError``."""
    if len(points) < 4:
        raise BadValueError(
            f"{len(points)} initial points or cells are too few to start from",
            "Give the data set a points3d.ply with more points, lower --set backbone.voxel_size, or train "
            "with --initial-points random.",
        )
    from scipy.spatial import KDTree  # here, because only this needs SciPy

    distances, _ = KDTree(points).query(points, k=4, workers=-1)
    return np.sqrt(np.mean(distances[:, 1:] ** 2, axis=1)).clip(1e-5)
