from .mcap_out import MeasurementWriter as MeasurementWriter
from .measurement_sink import MeasurementSink as MeasurementSink
from .table_reader import ForceTable as ForceTable
from .table_reader import read_force_table as read_force_table
from .table_reader import read_wrench_table as read_wrench_table
from .tables import FORCE_COLUMNS as FORCE_COLUMNS
from .tables import WRENCH_COLUMNS as WRENCH_COLUMNS
from .tables import TableWriter as TableWriter
