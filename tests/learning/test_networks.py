"""Networks: the published architecture, and equal results with a shared trunk."""

import pytest
import torch
from torch import nn

from hdsp.base.errors import InputError
from hdsp.learning.networks import build_network, count_parameters
from hdsp.learning.networks.swept import sample
from hdsp.robot.lattice import robot_frame_goals


class TextbookKlamt2019(nn.Module):
    """The published layer list, one task at a time: trunk, flatten, append the goal, fully connected, two heads."""

    def __init__(self):
        super().__init__()
        self.convolutions = nn.Sequential(
            nn.Conv2d(1, 3, 3, padding=1), nn.ReLU(),
            nn.Conv2d(3, 5, 7, padding=3), nn.ReLU(),
            nn.Conv2d(5, 28, 14), nn.ReLU(),
            nn.Conv2d(28, 31, 4), nn.ReLU(), nn.MaxPool2d(2),
            nn.Conv2d(31, 34, 3), nn.ReLU(), nn.MaxPool2d(2),
            nn.Conv2d(34, 36, 3), nn.ReLU(),
            nn.Conv2d(36, 38, 3), nn.ReLU(),
            nn.Conv2d(38, 40, 3), nn.ReLU(),
        )  # fmt: skip
        self.fully_connected = nn.Sequential(
            nn.Linear(1963, 500), nn.ReLU(),
            nn.Linear(500, 150), nn.ReLU(),
            nn.Linear(150, 50), nn.ReLU(),
            nn.Linear(50, 20), nn.ReLU(),
        )  # fmt: skip
        self.cost, self.feasibility = nn.Linear(20, 1), nn.Linear(20, 1)

    def forward(self, patch, goal):
        features = self.fully_connected(torch.cat([self.convolutions(patch[None, None]).flatten(), goal])[None])
        return self.cost(features).squeeze(), torch.sigmoid(self.feasibility(features)).squeeze()

    def load_from(self, network):
        """Copies our network's weights in layer order; there, one layer contains both heads."""
        *layers, heads_weight, heads_bias = network.state_dict().values()
        layers += [heads_weight[:1], heads_bias[:1], heads_weight[1:], heads_bias[1:]]
        names = list(self.state_dict())
        assert len(names) == len(layers)
        self.load_state_dict(dict(zip(names, layers, strict=True)))
        return self


@pytest.fixture
def patches():
    return torch.randn(3, 1, 72, 72, generator=torch.Generator().manual_seed(0)).clamp(-1.4, 1.4)


@pytest.fixture
def goals():
    return torch.from_numpy(robot_frame_goals(1)).expand(3, 22, 3)


def test_klamt2019_has_the_published_number_of_parameters():
    assert count_parameters(build_network({"architecture": "klamt2019"})) == 1_154_561


def test_klamt2019_with_shared_trunk_equals_the_textbook_network_task_by_task(patches, goals):
    network = build_network({"architecture": "klamt2019"}).eval()
    twin = TextbookKlamt2019().load_from(network)
    with torch.no_grad():
        cost, logits, *_ = network(patches, goals)
        for i in range(len(patches)):
            for j in range(0, 22, 3):
                twin_cost, twin_probability = twin(patches[i, 0], goals[i, j])
                assert abs(cost[i, j] - twin_cost) < 1e-4
                assert abs(logits[i, j].sigmoid() - twin_probability) < 1e-4


def test_he_initialisation_makes_the_trunk_depend_on_the_map():
    def variation(initialisation):
        torch.manual_seed(0)
        network = build_network({"architecture": "klamt2019", "initialisation": initialisation}).eval()
        with torch.no_grad():
            features = network.map_part(torch.rand(16, 1, 72, 72))
        return features.std(0).mean() / features.mean()

    assert variation("he") > 3 * variation("default")


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"architecture": "klamt"}, "model.architecture is 'klamt'; need one of klamt2019, compact, swept, "),
        ({"architcture": "compact"}, "model: unknown key 'architcture'"),
        ({"architecture": "compact", "options": {"width": 3}}, "model.options: unknown key 'width'"),
        ({"architecture": "klamt2019", "options": {"hidden": 3}}, "model.options: unknown key 'hidden'"),
        ({"initialisation": "zeros"}, "model.initialisation is 'zeros'; need 'he' or 'default'"),
        (
            {"architecture": "compact", "options": {"widths": [8]}},
            "model.options.blocks is [1, 1, 1]; need as many entries as widths, [8]",
        ),
        ({"encoding": {"clip": [1, 0]}}, "encoding.clip"),
    ],
)
def test_wrong_configurations_are_named(config, message):
    with pytest.raises(InputError) as error:
        build_network(config)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_sampling_equals_the_one_of_torch():
    random = torch.Generator().manual_seed(0)
    level = torch.rand(2, 36, 36, 5, generator=random)
    positions = torch.rand(2, 4, 7, 2, generator=random) * 90 - 9  # some lie outside
    grid = (positions / 36 - 1).flip(-1)  # torch: origin at the centre, unit half a patch, last axis first
    expected = nn.functional.grid_sample(
        level.permute(0, 3, 1, 2), grid, padding_mode="border", align_corners=False
    ).permute(0, 2, 3, 1)
    torch.testing.assert_close(sample(level, positions), expected)


def test_swept_points_reach_the_goal_with_the_robot():
    network = build_network({"architecture": "swept"})
    with torch.no_grad():
        network.points[0] = torch.tensor([13.0, 10.0])
    ahead, turned = network.positions(torch.tensor([[[2.0, -1.0, 0.0], [0.0, 0.0, 4.0]]]))[0]
    assert ahead[0, 0].tolist() == [36.5 + 13, 36.5 + 10]
    assert ahead[-1, 0].tolist() == [36.5 + 13 + 8, 36.5 + 10 - 4]
    torch.testing.assert_close(turned[-1, 0], torch.tensor([36.5 - 10, 36.5 + 13]))  # four headings are 90 degrees
