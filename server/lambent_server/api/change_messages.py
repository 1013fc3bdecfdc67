"""Bodies of the REST interface that change something; what is not given stays, null removes a label."""

from typing import Annotated

from lambent_core.pictures import WHOLE, Name
from pydantic import Field

from lambent_server.api.messages import ONLY_THESE, Given, LabelName
from lambent_server.api.parameters import SettingValue

LabelChange = Annotated[
    dict[LabelName, SettingValue | None], Field(max_length=64, json_schema_extra=ONLY_THESE)
]


class JobChange(Given):
    """What to change of a job."""

    labels: LabelChange | None = None
    priority: Annotated[int, Field(ge=-1000, le=1000), WHOLE] | None = None
    """Only while it waits."""


class SceneChange(Given):
    """What to change of a scene."""

    name: Name | None = None
    labels: LabelChange | None = None


class BundleChange(Given):
    """What to change of a bundle."""

    labels: LabelChange | None = None
