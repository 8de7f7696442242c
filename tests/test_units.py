"""Lengths with units."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crsfd_jax.options.units import format_length, parse_length


@pytest.mark.parametrize(
    ("text", "metres"),
    [
        ("8mm", 0.008),
        ("0mm", 0.0),
        (" 1.5 cm ", 0.015),
        ("2m", 2.0),
        ("1e1mm", 0.01),
        (".5mm", 5e-4),
    ],
)
def test_a_length_is_read_in_metres(text, metres):
    assert parse_length(text) == pytest.approx(metres, rel=1e-12)


@pytest.mark.parametrize(
    "text",
    ["8", "", "mm", "-1mm", "+1mm", "8 in", "8mm8", "nanmm", "infmm", "1e999mm", "8MM", "1,5mm"],
)
def test_a_text_that_is_no_length_is_refused_with_the_text_and_the_units(text):
    with pytest.raises(ValueError, match="mm, cm or m") as error:
        parse_length(text)
    assert repr(text) in str(error.value)


@given(st.floats(min_value=0, max_value=1000))
def test_formatting_inverts_parsing_to_six_digits(metres):
    assert math.isclose(parse_length(format_length(metres)), metres, rel_tol=1e-5)


@given(st.text())
def test_any_text_gives_a_length_or_a_value_error(text):
    try:
        assert parse_length(text) >= 0
    except ValueError as error:
        assert "allowed" in str(error)
