"""Robots whose bodies can differ: a hopper, a half-cheetah and an ant, by link lengths and mass."""

import math

import mujoco
import numpy as np

from ..worlds.design_space import DesignParameter
from .cheetah import Cheetah3
from .planar import Hopper
from .spatial import Ant


def _scale(spec: mujoco.MjSpec, link: str, child: str | None, factor: float) -> None:
    """Lengthen a link: its geom from the joint on, and where the next body is attached."""
    geom = spec.geom(link)
    if np.isfinite(geom.fromto).all():
        geom.fromto = factor * geom.fromto
    else:
        geom.pos, geom.size = factor * geom.pos, geom.size * [1, factor, 1]
    if child is not None:
        spec.body(child).pos *= factor


class DesignedHopper(Hopper):
    """The hopper with thigh and calf of other lengths; its foot and `z` start as usual."""

    designs = {"thigh": DesignParameter(0.33, 0.2, 0.5), "calf": DesignParameter(0.32, 0.2, 0.5)}

    @classmethod
    def shape(cls, spec: mujoco.MjSpec, design: dict[str, float]) -> None:
        for link, child in (("thigh", "calf"), ("calf", "foot")):
            usual = cls.designs[link].default
            _scale(spec, link, child, design[link] / usual)
            spec.body("torso").pos[2] += design[link] - usual


class DesignedCheetah(Cheetah3):
    """The half-cheetah with six link lengths; its lower foot starts as high as usual."""

    designs = {
        "back_thigh": DesignParameter(0.297, 0.18, 0.42),
        "back_shin": DesignParameter(0.313, 0.19, 0.44),
        "back_foot": DesignParameter(0.188, 0.11, 0.26),
        "front_thigh": DesignParameter(0.278, 0.17, 0.39),
        "front_shin": DesignParameter(0.222, 0.13, 0.31),
        "front_foot": DesignParameter(0.14, 0.08, 0.2),
    }
    depths = {"back": (0.25, 0.14, 0.188), "front": (0.24, 0.18, 0.128)}  # m that links reach down

    @classmethod
    def shape(cls, spec: mujoco.MjSpec, design: dict[str, float]) -> None:
        rise = []
        for leg, depths in cls.depths.items():
            links = [f"{leg[0]}{part}" for part in ("thigh", "shin", "foot")]
            names = [name for name in cls.designs if name.startswith(leg)]
            factors = [design[name] / cls.designs[name].default for name in names]
            for link, child, factor in zip(links, [*links[1:], None], factors, strict=True):
                _scale(spec, link, child, factor)
            rise.append(np.dot(depths, factors) - sum(depths))
        spec.body("torso").pos[2] += max(rise)


class DesignedAnt(Ant):
    """The ant with upper and lower legs of other lengths, and another mass of its torso."""

    designs = {
        "upper_leg": DesignParameter(0.283, 0.15, 0.4),
        "lower_leg": DesignParameter(0.566, 0.3, 0.8),
        "torso_mass": DesignParameter(0.327, 0.2, 1.0, "kg"),
    }

    @classmethod
    def shape(cls, spec: mujoco.MjSpec, design: dict[str, float]) -> None:
        upper, lower, mass = (design[name] / usual.default for name, usual in cls.designs.items())
        for foot in (body for body in spec.bodies if body.name.startswith("foot")):
            leg = foot.parent
            _scale(spec, leg.geoms[0].name, foot.name, upper)
            _scale(spec, foot.geoms[0].name, None, lower)
        spec.geom("torso_geom").density *= mass
        # the ankle starts 0.5 rad below the horizontal
        rise = math.sin(0.5) * cls.designs["lower_leg"].default * (lower - 1)
        spec.body("torso").pos[2] += rise
