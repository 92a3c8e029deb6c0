# SPDX-License-Identifier: GPL-3.0-or-later
"""What a training does, where its configuration and its scene decide it together: asked once."""

from dataclasses import dataclass

from ..model.backbone import BackboneConfig
from ..scene.points import with_points_file
from ..scene.scene import Scene
from .config import Switch, TrainConfig, in_iterations
from .views import Seen, seen_by


@dataclass(frozen=True)
class Plan:
    """``config`` on what it has ``seen`` of a scene, with every question answered that needs both."""

    config: TrainConfig
    seen: Seen
    #: Its steps are iterations of this training, as are those of the SH degree.
    backbone: BackboneConfig
    sh_degree_every: int
    #: Whether the method draws a backbone's splats.
    splats: bool
    #: The kind of the data set's points (``scene.points``), where primitives begin at them; else "".
    points_origin: str
    #: Whether points far away fill what the first points leave uncovered.
    far_shell: bool
    #: Whether Gaussians go that are nearer to a camera than anything that it photographed.
    clears_cameras: bool
    #: Whether pictures have the light of their whole brackets; auto: where these show noise.
    merges: Switch

    @property
    def iterations(self) -> int:
        """How long the training is."""
        return self.config.iterations


def planned(scene: Scene, config: TrainConfig) -> Plan:
    """The plan of training ``config`` on ``scene``, without reading a picture.

    Raises ``BadValueError`` and ``DataMismatchError`` where the scene has nothing that it may see, and what
    reading a ``points_file`` raises.
    """
    seen = seen_by(with_points_file(scene, config.points_file), config)
    schedule, traits, points = in_iterations(config), config.method.traits, seen.scene.points

    def is_on(setting: Switch) -> bool:
        """Of what photographs need; published methods stay as they were published."""
        by_itself = setting == "auto" and scene.photographs and traits.effects
        return traits.splats and (setting == "on" or by_itself)

    begins_at_points = config.initial_points in ("auto", "both", "file") and points is not None
    return Plan(
        config=config,
        seen=seen,
        backbone=schedule.backbone,
        sh_degree_every=schedule.sh_degree_every,
        splats=traits.splats,
        points_origin=points.origin if points is not None and begins_at_points else "",
        # Points that bring their own colours have none for what is far away.
        far_shell=is_on(config.far_shell) and traits.initial_radiance == "merged",
        clears_cameras=is_on(config.clear_cameras),
        # Networks learn from the pictures' own pixels, published methods from pictures as they were taken.
        merges=config.merged_brackets
        if traits.splats and (config.merged_brackets == "on" or traits.effects)
        else "off",
    )
