"""The pictures of a model while it trains: a long run sends thousands, of which its history keeps some."""

from sqlalchemy import Connection

from lambent_server.database.model import JobRow
from lambent_server.database.schema import events
from lambent_server.database.tenancy import change, rows
from lambent_server.jobs.rows import owner
from lambent_server.storage.store import discard

TURNING = "turning_"
"""Begins the names of pictures between which the camera has moved on by a step
(`lambent_run.run.live_preview`)."""
SHEET = "evaluation"
"""Name of the sheet of an evaluation (`lambent_run.run.tasks.evaluate`): its pictures are too small for a
card."""
NEWEST = 48
"""Two turns in steps of 15 degrees: of these every picture is kept."""
EARLIER = 96
"""Of those before at most so many, the sparser the older they are."""


def thin(connection: Connection, job: JobRow) -> None:
    """Let go of earlier turning pictures of a job where there are too many: every second one.

    Their events stay in the history, without the hash of a picture: numbers of events have no gaps. Other
    previews (of an evaluation, of renderings) are results and stay.
    """
    mine = (events.c.job_id == job.id, events.c.type == "preview", events.c.sha256 != "")
    turning = events.c.name.startswith(TURNING, autoescape=True)
    statement = rows(owner(job), events, events.c.seq, events.c.sha256).where(*mine, turning)
    earlier = connection.execute(statement.order_by(events.c.seq)).all()[:-NEWEST]
    if len(earlier) <= EARLIER:
        return
    # The first one stays whatever comes: it shows how it began.
    gone = earlier[1::2]
    update = change(owner(job), events).where(
        events.c.job_id == job.id, events.c.seq.in_([seq for seq, _ in gone])
    )
    connection.execute(update.values(sha256=""))
    for _, sha256 in gone:
        discard(connection, owner(job), sha256)
