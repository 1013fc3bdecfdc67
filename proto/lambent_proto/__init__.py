"""Messages between the programs of Lambent, and what all of them agree on."""

BUNDLE_VERSION = "1"
"""`schema_version` of the bundles that are written and read; readers refuse any other."""
