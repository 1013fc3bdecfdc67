"""Runs the evaluation of a model: predictions, metrics, report.json and report.html."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from lambent_core.files import write_json
from lambent_core.messages import message_to_dict
from lambent_core.scene import View
from lambent_proto.v1 import evaluation_pb2
from numpy import ndarray

from lambent_run.report import figures, protocol
from lambent_run.report.absent import absent_metrics
from lambent_run.report.common_factor import common_factor_note
from lambent_run.report.environment_scores import score_environments
from lambent_run.report.page import write_page
from lambent_run.report.predictions import (
    load,
    over_white,
    predict_relit,
    predict_surfaces,
    predict_uncertainty,
)
from lambent_run.report.published import object_group, published_scene
from lambent_run.report.request import UNSCALED_VIEWS, Subject
from lambent_run.report.scores import Ruling, albedo_ratios, score

SCHEMA_VERSION = "1.1"
SHEET_VIEWS = 3


def evaluate(
    subject: Subject, *, preset: str, seconds: Mapping[str, float]
) -> evaluation_pb2.EvaluationReport:
    """Render, score and write everything below `subject.out`; returns what is in report.json.

    Pictures that exist already are kept: the caller clears the folder when they would differ.
    """
    predict_surfaces(subject)
    predict_uncertainty(subject)
    ratios = albedo_ratios(subject.out, subject.views)
    median = np.ones(3) if ratios is None else ratios[0]
    predict_relit(subject, (float(median[0]), float(median[1]), float(median[2])))
    ruling = Ruling.of(subject.scene, held_out=subject.held_out, dataset=subject.dataset, lpips=subject.lpips)
    table = score(subject.out, subject.scene, subject.views, ruling)
    score_environments(table, subject)
    rows = table.as_metrics()
    report = evaluation_pb2.EvaluationReport(
        schema_version=SCHEMA_VERSION,
        protocol_version=protocol.VERSION,
        protocol=protocol.SUMMARY,
        scene=subject.scene.name,
        preset=preset,
        seed=subject.seed,
        num_views=len(subject.views),
        num_secondary_rays=subject.request.num_directions,
        num_repeats=subject.request.num_repeats,
        antialias=subject.request.antialias,
        metrics=rows,
        absent=absent_metrics(subject, (row.name for row in rows)),
        albedo_ratio_rgb=[] if ratios is None else median.tolist(),
        albedo_ratio_least_squares_rgb=[] if ratios is None else ratios[1].tolist(),
        dataset=subject.dataset,
        object_group=object_group(subject.dataset, subject.scene.name),
        published=[
            evaluation_pb2.PublishedResult(method=row.method, values=dict(row.values))
            for row in published_scene(subject.dataset, subject.scene.name)
        ],
        train_lights=subject.scene.lights,
        seconds=dict(seconds),
        notes=_notes(subject, has_ratio=ratios is not None),
    )
    write_json(subject.out / "report.json", message_to_dict(report))
    write_page(
        subject.out / "report.html",
        report,
        subject.out,
        subject.scene,
        subject.views,
        None if ratios is None else median,
    )
    return report


def preview_sheet(subject: Subject) -> bytes:
    """Return a PNG with photograph, physically based picture, albedo and normals of a few views."""
    rows = [_sheet_row(subject, view) for view in subject.views[:SHEET_VIEWS]]
    return figures.png(figures.contact_sheet(rows), max_side=512)


def _sheet_row(subject: Subject, view: View) -> list[Float[ndarray, "height width 3"]]:
    light = subject.scene.lights[0]
    albedo = load(subject.out, "pred", view, "albedo")
    normal = load(subject.out, "pred", view, "normal")
    rendered = load(subject.out, "pred", view, f"rgba_{light}")
    assert albedo is not None
    assert normal is not None
    assert rendered is not None
    alpha = albedo[..., 3:]
    return [
        over_white(view.images[light]),
        figures.picture(rendered),
        figures.albedo_map(albedo[..., :3]) * alpha + (1.0 - alpha),
        figures.normal_map(normal, alpha),
    ]


def _notes(subject: Subject, *, has_ratio: bool) -> list[str]:
    notes = []
    if not subject.held_out:
        notes.append("The scene has no test views; the figures are on training views and flatter the model.")
    if subject.scene.turned:
        notes.append(
            "The light did not stand still with the object: every picture under the training light is "
            "rendered with the turn that the light had at that view."
        )
    if has_ratio and subject.maps:
        notes.append(
            "Relit pictures use albedo times the median ratio; relight_unscaled, on at most "
            f"{UNSCALED_VIEWS} views, does without."
        )
    open_factor = common_factor_note(subject)
    if open_factor is not None:
        notes.append(open_factor)
    if subject.request.num_repeats == 1:
        notes.append("With one repeat the standard error of a picture is an upper estimate.")
    if subject.rule.control_variate == "off":
        notes.append("Trained without control variate: pictures and shadows come from the NeRF cache.")
    return notes
