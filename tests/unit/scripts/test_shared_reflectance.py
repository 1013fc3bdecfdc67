import re

import pytest
from shared_reflectance import SOURCE, translated

TEXT = SOURCE.read_text()


def test_both_languages_have_the_functions_of_python():
    script, shader = (translated(TEXT, shader=shader) for shader in (False, True))
    assert "return metalness * albedo + (1.0 - metalness) * dielectricF0;" in script
    assert "return metalness * albedo + (1.0 - metalness) * DIELECTRIC_F0;" in shader
    assert "Math.PI * power2(Math.max(" in script
    assert "pi * power2(max(" in shader
    names = re.findall(r"^float (\w+)", shader, re.MULTILINE)
    assert names == re.findall(r"function (\w+)", script)
    assert names[:2] == ["power2", "power5"]


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("DIELECTRIC_F0\n", "FRESNEL\n", "FRESNEL is unknown"),
        ("** 5", "** 4.5", "is not a whole power"),
        ("k = 0.5 * alpha", "k, j = alpha, alpha", "cannot be translated"),
        ("0.5 * alpha", "alpha if alpha else 1.0", "cannot be translated"),
        ("math.pi", "math.e", "math.e is unknown"),
    ],
)
def test_what_only_python_has_is_refused(before: str, after: str, message: str):
    assert before in TEXT
    with pytest.raises(ValueError, match=message):
        translated(TEXT.replace(before, after), shader=True)
