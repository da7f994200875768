"""Figures and pages: Run -> Figure -> one self-contained HTML page.

`write_report` is the way in. matplotlib and jinja2 are imported only when a page is written.
"""

from reports.page import write_report
from reports.tables import Trial, compare_table
from reports.view import RunLike

__all__ = ["RunLike", "Trial", "compare_table", "write_report"]
