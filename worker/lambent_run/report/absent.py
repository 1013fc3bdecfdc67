"""Lists the metrics of the protocol that a report lacks, with the reason for each."""

from collections.abc import Iterable

from lambent_proto.v1 import evaluation_pb2

from lambent_run.report.environment_scores import scored_lights
from lambent_run.report.published import dataset_of
from lambent_run.report.request import Subject

LPIPS_REASON = "needs network weights: give --lpips-weights FILE (docs/reference/protocol.md)"


def absent_metrics(subject: Subject, present: Iterable[str]) -> list[evaluation_pb2.AbsentMetric]:
    """Return the figures that are not among the names `found`, each with the reason."""
    names = set(present)
    reasons: dict[str, str] = {}
    truth = {kind for view in subject.views for kind in view.truth}
    if "albedo" not in truth:
        reasons["albedo_rgb_ratio/psnr_gamma"] = "the capture has no true albedo"
    if "normal" not in truth:
        reasons["normal/mae_all"] = "the capture has no true normals"
    if not subject.held_out:
        reasons["nvs/psnr"] = "the capture has no test views"
    reasons |= _relighting(subject)
    reasons |= _environments(subject)
    if dataset_of(subject.dataset) == "openillumination" and len(subject.scene.lights) > 1:
        reasons["nvs/psnr"] = "on OpenIllumination novel views count from a run in one light"
    if subject.uncertainty is None:
        reasons["uncertainty/albedo_rank_correlation"] = (
            "the uncertainty of materials was not measured: the preset leaves it out, the model has no "
            "surface, or the capture it was trained on is gone"
        )
    if subject.lpips is None:
        groups = {name.split("/")[0] for name in names if name.count("/") == 1 and name.endswith("/ssim")}
        reasons |= {f"{group}/lpips": LPIPS_REASON for group in sorted(groups)}
    return [
        evaluation_pb2.AbsentMetric(name=name, reason=reason)
        for name, reason in reasons.items()
        if name not in names
    ]


def _environments(subject: Subject) -> dict[str, str]:
    lights, given = subject.scene.lights, subject.known_lights
    was_given = "the light was given (--known-light), not learned"
    reasons = {f"environment/{light}/log_rmse": was_given for light in given if len(lights) > 1}
    if subject.scene.turned:
        reasons["environment/log_rmse"] = "the light turned from photograph to photograph"
    elif set(given) == set(lights):
        reasons["environment/log_rmse"] = was_given
    elif not scored_lights(subject):
        reasons["environment/log_rmse"] = (
            f"the true environment is not known: envmaps/{lights[0]}.hdr in the capture, or a map of this "
            "name in --environments"
        )
    return reasons


def _relighting(subject: Subject) -> dict[str, str]:
    scene = subject.scene
    if not scene.relight_lights:
        return {"relight/psnr": "the capture has no pictures in other light"}
    missing = [light for light in scene.relight_lights if light not in subject.maps]
    reasons = {f"rgb/{light}/psnr": "--environments holds no map of this name" for light in missing}
    if len(missing) == len(scene.relight_lights):
        reasons["relight/psnr"] = (
            "no environment map was given: --environments DIR with maps named like the lights"
        )
    elif dataset_of(subject.dataset) == "openillumination" and len(scene.lights) == 1:
        reasons["relight/psnr"] = "on OpenIllumination relit pictures count from a run in several lights"
    return reasons
