import numpy as np
from lambent_run.report.figures import contact_sheet


def test_a_sheet_has_room_for_pictures_of_different_sizes():
    black = [np.zeros((4, 6, 3)), np.zeros((8, 3, 3))]
    sheet = contact_sheet([black[:1], black])
    assert sheet.shape == (2 * 8 + 4, 2 * 6 + 4, 3)
    assert (sheet == 0.0).sum() == 3 * (2 * 4 * 6 + 8 * 3)
    assert sheet[12, 10:13].max() == 0.0
