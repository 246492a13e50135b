"""Parsing a long PLY header takes time in proportion to its length."""

import pytest

from alula.schemas.errors import ArtifactError
from alula.stages.reconstruction.formats.ply import check_harmonics
from alula.stages.reconstruction.formats.ply_header import parse_header


def test_elements_of_one_name_are_refused_among_many():
    """60,000 of them fit into the header; comparing each with all before it would take minutes."""
    lines = ["ply", "format ascii 1.0", *(f"element e{i} 0" for i in range(60_000))]
    header = parse_header("\n".join([*lines, "end_header", ""]).encode())
    assert len(header.elements) == 60_000
    with pytest.raises(ArtifactError, match="line 60003 makes no sense: 'element e7 0'"):
        parse_header("\n".join([*lines, "element e7 0", "end_header", ""]).encode())


def test_many_coefficients():
    names = [f"f_rest_{i}" for i in range(36_000)]
    with pytest.raises(ArtifactError, match="36000 properties f_rest"):
        check_harmonics(names)
    with pytest.raises(ArtifactError, match="f_rest_5 is missing"):
        check_harmonics([*names[:5], *names[6:]])
    with pytest.raises(ArtifactError, match="f_rest_5 occurs twice"):
        check_harmonics([*names, "f_rest_5"])
