import torch
from flashcache.losses.normals import normal_consistency, orientation

WEIGHTS = torch.tensor([[0.2, 0.5]])
DIRECTION = torch.tensor([[0.0, 0.0, -1.0]])
UP, DOWN = [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]


def test_equal_normals_cost_nothing():
    up = torch.tensor([UP, UP])
    assert normal_consistency(WEIGHTS, up, up, 0.1) == 0.0


def test_both_normals_get_the_gradient_of_the_supplements_loss():
    predicted = torch.tensor([UP, [0.6, 0.0, 0.8]]).requires_grad_()
    derived = torch.tensor([DOWN, [0.0, 1.0, 0.0]]).requires_grad_()
    normals = [predicted, derived]
    printed = (WEIGHTS[0] * (predicted - derived).square().sum(dim=-1)).sum()
    expected = torch.autograd.grad(printed, normals)
    found = torch.autograd.grad(normal_consistency(WEIGHTS, predicted, derived, 0.1), normals)
    torch.testing.assert_close(found, expected)


def test_weights_get_their_share_of_the_gradient_from_one_side_only():
    gradients = []
    for share in (1.0, 0.1):
        weights = WEIGHTS.clone().requires_grad_()
        normal_consistency(weights, torch.tensor([UP, UP]), torch.tensor([DOWN, UP]), share).backward()
        gradients.append(weights.grad)
    torch.testing.assert_close(gradients[1], 0.1 * gradients[0])


def test_normals_towards_the_camera_cost_nothing_and_others_their_weighted_cosine():
    assert orientation(WEIGHTS, torch.tensor([UP, UP]), DIRECTION) == 0.0
    torch.testing.assert_close(orientation(WEIGHTS, torch.tensor([UP, DOWN]), DIRECTION), torch.tensor(0.5))
