"""Dates of sessions: who is asked first, and what is no date."""

from datetime import UTC, datetime

import pytest

from hil_forceps.data.sessions.dates import date_in, date_of
from hil_forceps.rig.errors import UserError


@pytest.mark.parametrize(
    ("name", "date"),
    [
        ("2026-11-28", datetime(2026, 11, 28, tzinfo=UTC)),
        ("left_20261128_0930", datetime(2026, 11, 28, 9, 30, tzinfo=UTC)),
        ("2026-11-28T09-30-15", datetime(2026, 11, 28, 9, 30, 15, tzinfo=UTC)),
        ("20261128T093015Z_run", datetime(2026, 11, 28, 9, 30, 15, tzinfo=UTC)),
        ("2026-11-28/run7", datetime(2026, 11, 28, tzinfo=UTC)),
        ("2025-01-01/2026-11-28_2", datetime(2026, 11, 28, tzinfo=UTC)),
    ],
)
def test_a_date_in_a_name(name: str, date: datetime) -> None:
    assert date_in(name) == date


@pytest.mark.parametrize("name", ["28-11-2026", "11-28-2026", "20261340", "120261128", "session7", "2026-1128", ""])
def test_what_is_no_date_for_sure_is_none(name: str) -> None:
    assert date_in(name) is None


def test_the_table_goes_before_the_recording_that_before_the_name_and_the_file_only_where_asked() -> None:
    told, recorded, name = "2026-01-01", "2026-02-02T10:00:00+02:00", "2026-03-03"
    assert date_of(name, told, recorded, 0.0)[1] == "table"
    assert date_of(name, "", recorded, 0.0) == (datetime(2026, 2, 2, 8, tzinfo=UTC), "recording")
    assert date_of(name, "", "", 0.0)[1] == "name"
    assert date_of("a", "", "", 86400.0) == (datetime(1970, 1, 2, tzinfo=UTC), "file")
    assert date_of("a", "", "", None) == (None, "")
    assert date_of(name, "", "damaged", None)[1] == "name"


def test_a_date_of_the_table_that_is_none_is_refused() -> None:
    with pytest.raises(UserError, match="session a: date 'soon': is not a date; write it as 2026-11-28"):
        date_of("a", "soon", "", None)
