"""Pages of jobs by what they are, each read from an index in the order of the page.

A page is merged from the beginnings of a few lists, each of which an index holds in the order of the ids: the
jobs of a state, of a kind in a state, of a scene, with a label, of a preset. What else is wanted is checked
for the jobs of these lists, from their beginning until the page is full.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from sqlalchemy import ColumnElement, Connection, Select, false, func, or_, select, union

from lambent_server.api.search import named
from lambent_server.database.schema import job_labels, jobs, scenes
from lambent_server.database.tenancy import Tenant, rows, rows_by_other_index, without_index
from lambent_server.jobs.rows import FINAL

FEW_SCENES = 300
"""Up to so many matching scenes are found first, and then their jobs; else the newest jobs are checked."""
_LAST = "z" * 64
"""After all that may follow in an id or the name of a preset."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Wanted:
    """What the jobs of a page have in common."""

    states: Sequence[str] = ()
    kinds: Sequence[str] = ()
    labels: Sequence[tuple[str, ...]] = ()
    scene_id: str | None = None
    words: str = ""
    """Part of the scene's name, in any case, or the beginning of the job's id or its preset's name."""


def page(
    connection: Connection,
    tenant: Tenant,
    wanted: Wanted,
    *,
    after: str | None,
    oldest_first: bool,
    num_rows: int,
) -> Select[Any]:
    """Return the query of up to `num_rows` jobs that follow the job `after` in the order of the page."""

    def ordered(statement: Select[Any], identifier: Any) -> Select[Any]:
        if after is not None:
            statement = statement.where(identifier > after if oldest_first else identifier < after)
        return statement.order_by(identifier.asc() if oldest_first else identifier.desc()).limit(num_rows)

    lists = list(_lists(connection, tenant, wanted))
    if not lists:
        return rows(tenant, jobs).where(false())
    starts = [ordered(each.ids, each.order).subquery() for each in lists]
    merged = union(*(select(start.c[0].label("id")) for start in starts)).subquery()
    chosen = ordered(select(merged.c.id), merged.c.id).subquery()
    return ordered(select(jobs).join(chosen, chosen.c.id == jobs.c.id), jobs.c.id)


@dataclass(frozen=True, slots=True)
class _List:
    """Ids of jobs that an index holds in their order, and what to order them by."""

    ids: Select[Any]
    order: Any = jobs.c.id


def _lists(connection: Connection, tenant: Tenant, wanted: Wanted) -> Iterator[_List]:
    of_tenant = rows(tenant, jobs, jobs.c.id)
    unfinished = bool(wanted.states) and FINAL.isdisjoint(wanted.states)
    # Of unfinished jobs there are few, whatever else they are.
    if wanted.words and not unfinished:
        yield from _found_by_words(connection, tenant, wanted)
    elif wanted.scene_id is not None and not unfinished:
        of_scene = rows_by_other_index(tenant, jobs, jobs.c.id).where(jobs.c.scene_id == wanted.scene_id)
        yield _List(of_scene.where(*_rest(tenant, wanted, "scene")))
    elif wanted.labels and not unfinished:
        yield _labelled(tenant, wanted)
    elif unfinished or (wanted.states and not wanted.kinds):
        rest = _rest(tenant, wanted, "state")
        for state in wanted.states:
            yield _List(of_tenant.where(jobs.c.state == state, *rest))
    elif wanted.states:
        for kind, state in product(wanted.kinds, wanted.states):
            yield _List(of_tenant.where(jobs.c.kind == kind, jobs.c.state == state))
    elif wanted.kinds:
        for kind in wanted.kinds:
            yield _List(of_tenant.where(jobs.c.kind == kind))
    else:
        yield _List(of_tenant)


def _rest(tenant: Tenant, wanted: Wanted, given_by: str) -> list[ColumnElement[bool]]:
    """Return the conditions that the index of a list does not answer."""
    conditions: list[ColumnElement[bool]] = []
    if wanted.states and given_by != "state":
        conditions.append(without_index(jobs.c.state).in_(wanted.states))
    if wanted.kinds:
        conditions.append(without_index(jobs.c.kind).in_(wanted.kinds))
    if wanted.scene_id is not None and given_by != "scene":
        conditions.append(without_index(jobs.c.scene_id) == wanted.scene_id)
    for name, value in wanted.labels if given_by != "label" else wanted.labels[1:]:
        held = (job_labels.c.job_id == jobs.c.id, job_labels.c.name == name, job_labels.c.value == value)
        conditions.append(_found(select(job_labels.c.job_id).where(*held)))
    if wanted.words and given_by != "words":
        begins = [column.startswith(wanted.words, autoescape=True) for column in (jobs.c.id, jobs.c.preset)]
        conditions.append(or_(_in_named_scene(tenant, wanted.words), *begins))
    return conditions


def _found(statement: Select[Any]) -> ColumnElement[bool]:
    """Return the condition that a query finds a row, looked up for each row by itself.

    EXISTS would let PostgreSQL read all of a table into a hash table first.
    """
    return statement.limit(1).scalar_subquery().is_not(None)


def _labelled(tenant: Tenant, wanted: Wanted) -> _List:
    """Return the jobs with the first label; the index of labels holds their ids in order."""
    name, value = wanted.labels[0]
    held = rows(tenant, job_labels, job_labels.c.job_id).where(
        job_labels.c.name == name, job_labels.c.value == value
    )
    if rest := _rest(tenant, wanted, "label"):
        held = held.where(_found(select(jobs.c.id).where(jobs.c.id == job_labels.c.job_id, *rest)))
    return _List(held, job_labels.c.job_id)


def _in_named_scene(tenant: Tenant, words: str) -> ColumnElement[bool]:
    name = scenes.c.name.icontains(words, autoescape=True)
    return _found(rows(tenant, scenes, scenes.c.id).where(scenes.c.id == jobs.c.scene_id, name))


def _found_by_words(connection: Connection, tenant: Tenant, wanted: Wanted) -> Iterator[_List]:
    words, rest = wanted.words, _rest(tenant, wanted, "words")
    of_tenant = rows(tenant, jobs, jobs.c.id).where(*rest)
    matching = named(connection, tenant, words)
    some = matching.limit(FEW_SCENES + 1).subquery()
    num_scenes = connection.execute(select(func.count()).select_from(some)).scalar_one()
    if num_scenes > FEW_SCENES:
        yield _List(of_tenant.where(_in_named_scene(tenant, words)))
    elif num_scenes:
        of_scenes = rows_by_other_index(tenant, jobs, jobs.c.id).where(jobs.c.scene_id.in_(matching), *rest)
        # Sorted: in the order of an index, all jobs would be checked.
        yield _List(of_scenes, without_index(jobs.c.id))
    if re.fullmatch("[a-z0-9_]+", words):
        yield _List(of_tenant.where(*_beginning(jobs.c.id, words)))
    for preset in _presets(connection, tenant, words):
        yield _List(of_tenant.where(jobs.c.preset == preset))


def _beginning(column: Any, words: str) -> tuple[ColumnElement[bool], ...]:
    """Return conditions that a column begins with `words`: limits, which an index serves, and what counts."""
    return column >= words, column < words + _LAST, column.startswith(words, autoescape=True)


def _presets(connection: Connection, tenant: Tenant, words: str) -> Iterator[str]:
    """Yield presets of the tenant's jobs that begin with `words`: the index leads from each to the next."""
    least = rows(tenant, jobs, func.min(jobs.c.preset)).where(jobs.c.preset < words + _LAST)
    preset = connection.execute(least.where(jobs.c.preset >= words)).scalar_one()
    while preset is not None:
        if preset.startswith(words):
            yield preset
        preset = connection.execute(least.where(jobs.c.preset > preset)).scalar_one()
