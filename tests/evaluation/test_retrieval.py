import numpy as np

from ebjax.evaluation.retrieval import precision_recall


def test_answers_are_accepted_by_score():
    score, right = np.array([0.1, 0.9, 0.5, 0.7]), np.array([True, True, False, True])
    precision, recall = precision_recall(score, right, 5)
    np.testing.assert_allclose(precision, [1, 1, 2 / 3, 3 / 4])
    np.testing.assert_allclose(recall, [0.2, 0.4, 0.4, 0.6])


def test_nobody_can_answer():
    precision, recall = precision_recall(np.zeros(2), np.zeros(2, bool), 0)
    np.testing.assert_array_equal(precision, 0)
    np.testing.assert_array_equal(recall, 0)
