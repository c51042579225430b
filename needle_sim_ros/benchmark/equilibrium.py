# SPDX-License-Identifier: Apache-2.0
"""Whether a state of the simulator is in equilibrium, worked out without its contact solve.

The displacement comes from a solve of its own with all unknowns, not from the condensed
compliances; the conditions of contact, beam and laws are written here a second time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from needle_sim_ros.geometry import Vector, rotation_matrix
from needle_sim_ros.interaction.friction import creep
from needle_sim_ros.interaction.spreading import coverage
from needle_sim_ros.interaction.state import ContactState
from needle_sim_ros.needle.tip import bevel_length
from needle_sim_ros.observation import Observation
from needle_sim_ros.simulator import Simulator, Snapshot
from needle_sim_ros.tissue.newmark import FullNewmark
from needle_sim_ros.tissue.reduced import ReducedNewmark

_TINY = 1e-300
# m; gaps below count as this much, or a straight path would be judged by rounding: coordinates
# of 0.1 m are known to 1.4e-17, and a hundred-millionth of a gap has to be several times that
_LEAST_GAP = 1e-8


@dataclass(frozen=True)
class Residuals:
    """What is left of each condition; 0 in perfect equilibrium.

    Attributes
    ----------
    balance : float
        Base force against the forces on the tissue, relative to the largest force.
    tissue : float
        The tissue's equation of motion with the contact forces as loads, relative to its
        largest term.
    condensed : float
        Displacement that the contact works with against that of the whole tissue,
        relative to the largest.
    lateral : float
        Distance of the track from the deflected needle, relative to the largest gap.
    friction : float
        Friction beyond its limit, relative to it; presliding or slip against the law,
        relative to the largest gap (only where the last step can be traced).
    tip : float
        Tip force out of its bounds, relative to the largest force.
    """

    balance: float = 0.0
    tissue: float = 0.0
    condensed: float = 0.0
    lateral: float = 0.0
    friction: float = 0.0
    tip: float = 0.0

    def worst(self) -> tuple[float, str]:
        """Return the largest and its name."""
        name = max(self.__dict__, key=lambda key: float(self.__dict__[key]))
        return float(self.__dict__[name]), name


def residuals(simulator: Simulator, before: Snapshot | None = None) -> Residuals:
    """Return what is left of every condition of equilibrium.

    Parameters
    ----------
    simulator : Simulator
    before : Snapshot, optional
        State a tick earlier; without it, or when the tick was divided, the history of friction
        is not checked.
    """
    state, seen = simulator.snapshot(), simulator.observe()
    contact = state.contact
    if contact.track is None:
        return Residuals()
    field = simulator._dynamics.everywhere(state.tissue, contact.track.table, contact.forces)
    table, loads = contact.track.table, contact.forces
    if isinstance(simulator._dynamics, ReducedNewmark):
        loads = state.tissue.filtered
    sampled = table.sample(field) + table.beyond_mesh(loads)
    largest = max(float(np.abs(sampled).max(initial=0.0)), _TINY)
    condensed = float(np.abs(contact.moved - sampled).max(initial=0.0)) / largest
    if largest < 1e-15:
        condensed = 0.0
    tissue = _tissue(simulator, state.tissue, contact, field)
    if contact.active == 0:
        return Residuals(tissue=tissue, condensed=condensed)
    lateral, friction = 0.0, 0.0
    if contact.inserted:
        lateral = _lateral(simulator, state, sampled)
        friction = _friction(simulator, state, before)
    return Residuals(_balance(seen), tissue, condensed, lateral, friction, _tip(simulator, contact))


def _balance(seen: Observation) -> float:
    forces = seen.contact_forces
    at_base = rotation_matrix(seen.base_orientation) @ seen.base_force
    largest = max(float(np.abs(forces).max(initial=0.0)), float(np.abs(at_base).max()))
    if largest == 0:
        return 0.0
    return float(np.abs(forces.sum(axis=0) + at_base).max()) / largest


def _tissue(simulator: Simulator, motion: Any, contact: ContactState, field: Vector) -> float:
    """Return the residual of Eq. (5), or of Eq. (1) with inertia."""
    model, dynamics = simulator._model, simulator._dynamics
    assert contact.track is not None
    table = contact.track.table
    if isinstance(dynamics, ReducedNewmark):
        rule, modal = dynamics.rule, table.modal() @ contact.forces.ravel()
        values = dynamics.eigenvalues
        u, v, a = motion.modal
        terms = [a, (rule.alpha + rule.beta * values) * v, values * u, -modal]
    else:
        free = model.free
        loads = table.spread(contact.forces).ravel()[free]
        u = field.ravel()[free]
        terms = [model.stiffness @ u, -loads]
        if isinstance(dynamics, FullNewmark):
            rule = dynamics.rule
            rates = rule.alpha * motion.v + motion.a
            terms += [model.mass @ rates, rule.beta * (model.stiffness @ motion.v)]
    largest = max(float(np.abs(term).max(initial=0.0)) for term in terms)
    return 0.0 if largest == 0 else float(np.abs(sum(terms)).max()) / largest


def _lateral(simulator: Simulator, state: Snapshot, sampled: Vector) -> float:
    """Return how far the track points are from where the deflected needle holds them."""
    scene, contact, pose = simulator.scene, state.contact, state.pose
    assert contact.track is not None
    held = len(contact.arclength)
    points, h = contact.track.points[:held], contact.track.spacing
    # a^2 (3 b - a) / 6EI
    s = contact.arclength
    short, long = np.minimum(s[:, None], s), np.maximum(s[:, None], s)
    flexibility = short**2 * (3 * long - short) / (6 * scene.needle.flexural_rigidity)
    bent = -(flexibility @ contact.lateral.T)
    # the bevel holds the tissue less and less towards the tip
    bevel = max(bevel_length(scene.needle), scene.needle.radius)
    width = scene.tissue.thickness / bevel if scene.dimension == 2 else 1.0
    grip = scene.tissue.youngs_modulus * h * width
    behind = scene.needle.length - s
    soft = np.zeros(held)
    part = np.minimum(behind[1:] / bevel, 1.0)
    soft[1:] = (1.0 - part) ** 2 / (part * grip)
    given = -soft[:, None] * contact.lateral.T
    aside = pose.aside(points + sampled[:held])
    scale = max(float(np.abs(pose.aside(points)).max()), float(np.abs(sampled).max()), _LEAST_GAP)
    return float(np.abs(aside - bent - given).max()) / scale


def _friction(simulator: Simulator, state: Snapshot, before: Snapshot | None) -> float:
    """Return how far friction is off its limit and its law of presliding."""
    scene, contact = simulator.scene, state.contact
    assert contact.track is not None
    track, n = contact.track, contact.active
    depth = scene.needle.length - float(contact.arclength[0])
    length = coverage(depth, n, track.spacing)
    beyond = np.abs(contact.friction) - track.static[:n] * length
    scale = max(float((track.static[:n] * length).max()), _TINY)
    excess = max(0.0, float(beyond.max()) / scale)
    past = None if before is None else before.contact
    if before is None or past is None or past.track is None or not past.inserted:
        return excess
    if past.track.laid != track.laid or past.active != n or past.depth == 0:
        return excess
    if state.parts > 1:
        return excess
    law = scene.interaction.friction
    pose = state.pose
    advance = float(pose.axial @ (pose.origin - before.pose.origin))
    passed = state.time - before.time
    # what slides goes on sliding as it did, what sticks rests
    ratio = advance / past.advance if advance * past.advance > 0 else 0.0
    longer = passed / past.lasted
    stuck, onward = past.status[:-1] == 0, past.status[:-1] * advance > 0
    way = np.where(stuck, 0.0, np.abs(past.slid) * np.where(onward, ratio, longer))
    heals = passed / law.healing_time / (1.0 + way / (creep(law) * passed))
    slip = past.slip * np.exp(-heals) - way * np.expm1(-heals) / heals
    fallen = np.clip(1.0 - slip / law.weakening_distance, 0.0, 1.0)
    limit = (track.kinetic[:n] + (track.static - track.kinetic)[:n] * fallen) * length
    presliding = contact.friction / (law.presliding_stiffness * np.maximum(length, 1e-300))
    used = length > 1e-6 * track.spacing
    drive = past.strain + advance + (past.moved[:n] - contact.moved[:n]) @ pose.axial
    slid = (drive - presliding)[used]
    force, bound = contact.friction[used], limit[used]
    excess = max(excess, float((np.abs(force) - bound).max(initial=0.0)) / scale)
    at_limit = np.abs(force) >= bound * (1 - 1e-9)
    wrong = np.where(at_limit, np.maximum(0.0, -slid * np.sign(force)), np.abs(slid))
    wrong[bound == 0] = 0.0
    gap = max(float(np.abs(drive).max()), float(np.abs(contact.moved).max()), _LEAST_GAP)
    return max(excess, float(wrong.max(initial=0.0)) / gap)


def _tip(simulator: Simulator, contact: ContactState) -> float:
    """Return how far the tip force is out of its bounds."""
    assert contact.track is not None
    # a bound that jumps at an interface is met within a step: the highest so far counts
    passed = [s.limits for s in contact.track.stretches if s.depth <= contact.front]
    most = contact.track.stretches[0].limits.puncture
    ripple = 1.0 + simulator.scene.interaction.cutting.ripple.amplitude
    if contact.inserted:  # the opening comes on top of the cutting force
        most = max(most, *(max(x.cutting, x.puncture) for x in passed)) * ripple
    beyond = max(contact.tip - most, -contact.tip, 0.0)
    return 0.0 if beyond == 0 else beyond / max(most, _TINY)
