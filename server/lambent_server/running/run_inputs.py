"""Inputs of a run, for every kind of job."""

from dataclasses import dataclass

from lambent_proto.v1 import render_pb2
from sqlalchemy import Connection

from lambent_server.database.model import JobRow, SceneRow
from lambent_server.database.tenancy import find
from lambent_server.jobs import bakes as bake_rows
from lambent_server.jobs.rows import owner
from lambent_server.renders.tasks import describe_task
from lambent_server.storage.input_files import Files, bundle_inputs, environment_input, scene_inputs

_INPUTS = "inputs"


@dataclass(frozen=True, kw_only=True, slots=True)
class RunInputs:
    """The files of a run, the name of their folder, and the additional work to do with them."""

    files: Files
    name: str
    check_scene: bool = False
    render: render_pb2.RenderTask | None = None


def inputs_of(connection: Connection, job: JobRow) -> RunInputs:
    """Return the inputs of a run of this job: those of pictures, of a light bake, or a scene."""
    tenant = owner(job)
    if job.order_id is not None:
        files, task = describe_task(connection, job)
        return RunInputs(files=files, name=_INPUTS, render=task)
    if job.kind == bake_rows.KIND:
        bundle, environment = (job.params[name] for name in bake_rows.NEEDED)
        files = bundle_inputs(connection, tenant, bundle, "bundle")
        files += environment_input(connection, tenant, environment, "environment")
        return RunInputs(files=files, name=_INPUTS)
    scene = find(connection, tenant, SceneRow, job.scene_id)
    return RunInputs(
        files=scene_inputs(connection, tenant, job.scene_id),
        name=scene.name if scene is not None else "",
        check_scene=scene is None or scene.state != "ready",
    )
