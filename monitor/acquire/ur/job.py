"""A replay's task as JSON: the parent writes it, the streaming process reads it."""

import dataclasses
from typing import Any

import numpy as np

from monitor.acquire.driver import ReplayTask
from monitor.acquire.safety.band.basis import basis_from_document
from monitor.acquire.safety.way import left_from_document
from monitor.acquire.settings import Installation, ReplaySettings
from monitor.design.cell import cell_from_document
from monitor.model.fourier import excitation_from_document
from monitor.model.robot import load_robot
from monitor.recording import Context


def job_document(task: ReplayTask) -> dict[str, Any]:
    """The task as JSON can carry it; of the robot, its name and its limits."""
    settings = task.settings
    return {
        "settings": dataclasses.asdict(dataclasses.replace(settings, cell=None)),
        "cell": None if settings.cell is None else settings.cell.as_document(),
        "excitation": task.excitation.as_document(),
        "context": dataclasses.asdict(task.context),
        "installation": dataclasses.asdict(task.installation),
        "basis": task.basis.as_document(),
        "left": None if task.left is None else task.left.as_document(),
        "max_position_rad": task.robot.max_position_rad.tolist(),
        "max_speed_rad_s": task.robot.max_speed_rad_s.tolist(),
    }


def task_from_document(job: dict[str, Any]) -> ReplayTask:
    """The task from such a document; the robot is the published one with the limits that the document gives."""
    cell = None if job["cell"] is None else cell_from_document(job["cell"])
    excitation = excitation_from_document(job["excitation"])
    return ReplayTask(
        settings=ReplaySettings(**{**job["settings"], "cell": cell}),
        excitation=excitation,
        robot=dataclasses.replace(
            load_robot(excitation.robot),
            max_position_rad=np.array(job["max_position_rad"]),
            max_speed_rad_s=np.array(job["max_speed_rad_s"]),
        ),
        context=Context(**job["context"]),
        installation=_installation(job["installation"]),
        basis=basis_from_document(job["basis"]),
        left=None if job["left"] is None else left_from_document(job["left"]),
    )


def _installation(document: dict[str, Any]) -> Installation:
    """The installation from JSON, whose lists were tuples."""
    lists = {name: tuple(value) for name, value in document.items() if isinstance(value, list)}
    planes = tuple(tuple(plane) for plane in document["safety_planes"])
    return Installation(**{**document, **lists, "safety_planes": planes})
