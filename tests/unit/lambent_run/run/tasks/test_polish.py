"""The task that polishes a trained model, and its place among the others."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from flashcache.polish.confidence import FILE, Confidence
from flashcache.polish.polish import PolishReport
from flashcache.presets import tiny
from flashcache.training.checkpoint import CheckpointState, checkpoint_folder, save_checkpoint
from lambent_core.errors import Stopped
from lambent_run.run.card_option import GreyCard
from lambent_run.run.context import TaskContext
from lambent_run.run.folder import task_folder
from lambent_run.run.hashes import input_hashes, last_training_task
from lambent_run.run.spec import RunSpec
from lambent_run.run.tasks import polish
from lambent_run.run.tasks.training import load_final, load_trained, new_model, previews_for
from support.lit_sphere import lit_sphere
from support.task_context import task_context

SCENE = lit_sphere(num_views=3)
ON = replace(tiny(), polish="on")


def trained(tmp_path, monkeypatch, stop_after: int | None = None) -> TaskContext:
    """Return the context of the task in a run whose stage two is done."""
    monkeypatch.setattr(polish, "read_scene", lambda context: SCENE)
    made = task_context(tmp_path, ON, "polish", stop_after)
    model = new_model(made, SCENE)
    state = CheckpointState(stage="joint", step=7, seed=0, config_sha256="")
    save_checkpoint(checkpoint_folder(task_folder(made.run_dir, "joint"), 7), model, None, state)
    return made


def test_what_the_polish_makes_is_what_later_tasks_read(tmp_path, monkeypatch):
    context = trained(tmp_path, monkeypatch)

    def brighter(model, pixels, *, seed, card, advance, pulse):
        model.environment.head.bias.add_(1.0)
        advance(1)
        return PolishReport("", {"elements": 12.0})

    monkeypatch.setattr(polish, "polish", brighter)
    polish.run(context)
    before, after = load_trained(context, SCENE, "joint"), load_final(context, SCENE)
    assert torch.allclose(after.environment.head.bias, before.environment.head.bias + 1.0)
    assert context.reporter.named("polish.done") == [{"elements": 12.0}]


def test_previews_go_on_while_materials_are_fitted(tmp_path, monkeypatch):
    context, clock = trained(tmp_path, monkeypatch), [1000.0]
    made: list[float] = []

    def slow(model, camera):
        clock[0] += 2.0
        made.append(clock[0])
        return np.zeros((camera.height, camera.width, 3), np.float32)

    def fit(model, pixels, *, seed, card, advance, pulse):
        for part in range(9):
            for _ in range(3):
                clock[0] += 4.0
                pulse()
            advance(part + 1)
        return PolishReport("", {})

    def with_clock(context, scene):
        preview = previews_for(context, scene)
        preview.clock = lambda: clock[0]
        return preview

    monkeypatch.setattr("lambent_run.run.live_preview.turned_picture", slow)
    monkeypatch.setattr(polish, "previews_for", with_clock)
    monkeypatch.setattr(polish, "polish", fit)
    polish.run(context)
    assert np.diff(made).max() <= 30.0
    assert made[0] < 1030.0
    assert clock[0] - made[-1] <= 30.0
    shown = context.reporter.named("preview")
    assert [each["name"] for each in shown] == ["turning_polish"] * len(made)
    assert context.reporter.named("previews.made")[0]["number"] == len(made)


def test_a_model_without_a_surface_is_kept_and_the_user_hears_why(tmp_path, monkeypatch):
    context = trained(tmp_path, monkeypatch)
    polish.run(context)
    (told,) = context.reporter.named("polish.kept")
    assert "seen by two photographs" in told["reason"]
    (finding,) = context.reporter.named("finding")
    assert finding["code"] == "materials.not_fitted"
    assert told["reason"] in finding["message"]
    before, after = load_trained(context, SCENE, "joint"), load_final(context, SCENE)
    for one, other in zip(before.state_dict().values(), after.state_dict().values(), strict=True):
        assert torch.equal(one, other)


CARD = GreyCard("a.png", (1.0, 2.0, 3.0, 4.0), 0.5)


def with_card(tmp_path, monkeypatch) -> TaskContext:
    context = trained(tmp_path, monkeypatch)
    monkeypatch.setattr(polish, "read_manifest", lambda context: "manifest")
    return replace(context, spec=replace(context.spec, grey_card=CARD))


def test_the_polish_gets_the_cards_pixels_and_the_user_what_it_found(tmp_path, monkeypatch):
    context, asked = with_card(tmp_path, monkeypatch), []
    monkeypatch.setattr(polish, "check_grey_card", lambda *given: asked.append(given))
    monkeypatch.setattr(polish, "card_of", lambda *given: given[:3])

    def told(model, pixels, *, seed, card, advance, pulse):
        assert card == (CARD, SCENE, "manifest")
        return PolishReport("", {}, (("grey_card.brighter_than_white", "8 % of the surface"),))

    monkeypatch.setattr(polish, "polish", told)
    polish.run(context)
    assert asked == [(CARD, SCENE, "manifest")]
    (finding,) = context.reporter.named("finding")
    assert (finding["code"], finding["message"]) == ("grey_card.brighter_than_white", "8 % of the surface")


def test_a_card_that_was_not_used_because_nothing_was_polished_is_told(tmp_path, monkeypatch):
    context = with_card(tmp_path, monkeypatch)
    monkeypatch.setattr(polish, "check_grey_card", lambda *given: None)
    monkeypatch.setattr(polish, "card_of", lambda *given: "card")
    monkeypatch.setattr(polish, "polish", lambda *given, **named: PolishReport("few pieces"))
    polish.run(context)
    (finding,) = context.reporter.named("finding")
    assert finding["code"] == "grey_card.not_used"
    assert "few pieces" in finding["message"]


def test_a_stopped_polish_leaves_nothing_and_begins_again(tmp_path, monkeypatch):
    context = trained(tmp_path, monkeypatch, stop_after=0)
    monkeypatch.setattr(polish, "polish", lambda model, pixels, *, seed, card, advance, pulse: advance(1))
    with pytest.raises(Stopped):
        polish.run(context)
    assert not list(context.folder.glob("step_*"))


def test_evaluation_and_export_depend_on_the_polish_where_it_is_on(tmp_path):
    (tmp_path / "scene").mkdir()
    off, on = (input_hashes(RunSpec(scene=tmp_path / "scene", config=each)) for each in (tiny(), ON))
    assert "polish" not in off
    assert "polish" in on
    assert {name for name in off if off[name] == on[name]} == {"ingest", "masks", "cache", "joint"}
    assert (last_training_task(tiny()), last_training_task(ON)) == ("joint", "polish")


def test_confidence_lies_beside_the_checkpoint_and_not_where_stage_two_is_kept(tmp_path, monkeypatch):
    context = trained(tmp_path, monkeypatch)
    values = torch.full((2,), 0.1)
    sure = Confidence(torch.zeros(2, 3), 0.1, values[:, None].repeat(1, 3), values, values)
    monkeypatch.setattr(polish, "polish", lambda *given, **named: PolishReport("", {}, confidence=sure))
    polish.run(context)
    assert torch.equal(Confidence.load(context.folder / FILE).metalness, values)
    monkeypatch.setattr(polish, "polish", lambda *given, **named: PolishReport("few pieces"))
    polish.run(context)
    assert not (context.folder / FILE).exists()
