"""The same table as `tidy_csv`, as Parquet: columns t, antenna, tag, and rssi, phase, channel, doppler."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from testbed.logs.bad import LogError
from testbed.logs.blocks import MAX_BYTES
from testbed.logs.cells import Cells
from testbed.logs.contents import Contents, Job, finished
from testbed.logs.formats.tidy_csv import LAYOUT
from testbed.logs.reads import MAX_READS
from testbed.progress import Silent

ROWS = 65_536
MAX_COLUMNS = 1000
MAX_GROUP = 2 << 30  # bytes of a row group, unpacked
PLAIN = (pa.types.is_integer, pa.types.is_floating, pa.types.is_string, pa.types.is_timestamp)


class TidyParquet:
    """As `tidy_csv`. A file that unpacks to more than memory is meant for is refused before it is unpacked."""

    says = "the testbed's own table as Parquet: t (s), antenna, tag, and rssi (dBm), phase (rad), channel (from 0), doppler (Hz)"

    def read(self, job: Job) -> Contents:
        try:
            return self._read(job)
        except LogError:
            raise
        except (pa.ArrowException, OSError, KeyError, ValueError, OverflowError) as error:
            raise LogError(
                f"{job.path} can't be read as Parquet: {str(error).splitlines()[0] if str(error) else type(error).__name__}"
            ) from None

    def _read(self, job: Job) -> Contents:
        file = pq.ParquetFile(job.path)
        schema = file.schema_arrow
        self._bounded(file, job)
        columns, layout = LAYOUT.found(list(schema.names), job.site.log, str(job.path))
        odd = next((n for n in columns.values() if not any(fits(_plain(schema.field(n).type)) for fits in PLAIN)), None)
        if odd is not None:
            raise LogError(f"{job.path}: the column {odd!r} is of {schema.field(odd).type}: numbers, texts or times are wanted")
        taker, progress, row = job.taker(layout), job.progress or Silent(), 1
        progress.start(job.path.name, file.metadata.num_rows, 0)
        for batch in file.iter_batches(batch_size=ROWS, columns=list(dict.fromkeys(columns.values()))):
            cells = {name: _dense(batch.column(name)) for name in columns.values()}
            taker.take(Cells(np.arange(row, row + len(batch)), cells), columns, layout)
            row += len(batch)
            progress.advance(len(batch), 0)
        progress.finish()
        return finished(job, taker, layout)

    def _bounded(self, file: pq.ParquetFile, job: Job) -> None:
        metadata = file.metadata
        sizes = [metadata.row_group(i).total_byte_size for i in range(metadata.num_row_groups)]
        if (
            metadata.num_rows > MAX_READS
            or metadata.num_columns > MAX_COLUMNS
            or sum(sizes) > MAX_BYTES
            or max(sizes, default=0) > MAX_GROUP
        ):
            raise LogError(
                f"{job.path}: {metadata.num_rows:,} rows of {sum(sizes) >> 20:,} MiB when unpacked are too many: split the log by time"
            )


def _plain(kind: pa.DataType) -> pa.DataType:
    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
    return pa.string() if pa.types.is_large_string(kind) else kind


def _dense(column: pa.Array) -> pa.Array:
    """Without a dictionary; texts as plain ones."""
    if pa.types.is_dictionary(column.type):
        column = column.dictionary_decode()
    return column.cast(pa.string()) if pa.types.is_large_string(column.type) else column
