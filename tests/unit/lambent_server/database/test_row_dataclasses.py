"""Dataclasses of rows have the columns of their tables."""

from dataclasses import fields
from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints

import pytest
from lambent_server.database.model import JobRow
from lambent_server.database.schema import jobs
from sqlalchemy import JSON, Table

KINDS: list[tuple[type[Any], Table]] = [(JobRow, jobs)]


@pytest.mark.parametrize(("kind", "table"), KINDS)
def test_a_row_has_the_columns_of_its_table_with_their_types(kind: type[Any], table: Table):
    hints = get_type_hints(kind)
    assert {field.name for field in fields(kind)} == set(table.c.keys())
    for column in table.c:
        hint = hints[column.name]
        nullable = NoneType in get_args(hint)
        assert nullable == column.nullable, column.name
        (plain,) = set(get_args(hint)) - {NoneType} if nullable else {hint}
        if isinstance(column.type, JSON):
            assert get_origin(plain) in (dict, list), column.name
        else:
            assert plain is column.type.python_type, column.name
