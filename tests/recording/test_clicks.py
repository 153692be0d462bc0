"""The table of clicks: what is written is read, and what is wrong is told with its line."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from piegraph_cli.errors import DataError
from piegraph_cli.recording.clicks import Click, read_clicks, write_clicks

HEAD = "spot,camera,frame,column,row\n"


def key(click: Click) -> tuple:
    return click.spot, click.camera, click.frame, click.column, click.row


NAMES = st.text(st.characters(blacklist_categories=("C", "Z")), min_size=1, max_size=8)
CLICKS = st.builds(
    Click,
    NAMES,
    NAMES,
    st.integers(0, 9999),
    st.integers(0, 9999).map(lambda n: n / 10),
    st.integers(0, 9999).map(lambda n: n / 10),
)


@settings(deadline=None, max_examples=50)
@given(st.lists(CLICKS, unique_by=lambda c: (c.spot, c.camera, c.frame)))
def test_what_is_written_is_read(tmp_path_factory, clicks):
    path = tmp_path_factory.mktemp("clicks") / "one.csv"
    write_clicks(path, clicks)
    assert [key(click) for click in read_clicks(path)] == [key(click) for click in clicks]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "line 1: has the columns (none)"),
        ("spot,camera,frame,x,y\na,c,0,1,2\n", "line 1: has the columns spot,camera,frame,x,y"),
        (HEAD + "a,cam0,0,12\n", "line 2: has 4 values, the header 5"),
        (HEAD + "a,cam0,0,12,nan\n", "line 2: is no click"),
        (HEAD + "a,cam0,1.5,12,30\n", "line 2: is no click"),
        (HEAD + ",cam0,1,12,30\n", "line 2: is no click"),
        (
            HEAD + "a,cam0,1,12,30\nb,cam0,1,9,9\na,cam0,1,13,30\n",
            "line 4: spot a was clicked in frame 1 of camera cam0",
        ),
    ],
)
def test_what_is_no_click_is_told_with_its_line(tmp_path, text, said):
    path = tmp_path / "one.csv"
    path.write_text(text)
    with pytest.raises(DataError) as error:
        read_clicks(path)
    assert said in str(error.value)
