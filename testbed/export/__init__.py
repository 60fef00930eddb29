"""What a run found, in the formats of others: one module a format, each with functions from the testbed's data to plain data."""
