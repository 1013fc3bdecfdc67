"""The tables of the first release, which `database.creation` makes.

This revision has only a name. A new database is created with the tables of `schema` and marked with the
newest revision; it runs no migrations. Later revisions run only on databases that an earlier release has
created, so they never meet what `create_tables` makes of a later `schema`, and the first state need not be
written down a second time. The test of the first migration needs it: keep the statements of this release as
test data then.

Names of revisions are `r` and four digits; any other is from before the first release.
"""

revision = "r0001"
down_revision = None
