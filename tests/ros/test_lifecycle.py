# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The managed node: what it runs when, what it releases, how it fails."""

import threading

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import String

from plant_sim.plant_node import PlantNode
from ros2_deepc.nodes.controller_node import ControllerNode
from ros2_deepc.nodes.monitor_node import MonitorNode
from ros2_deepc.nodes.operator_node import OperatorNode
from ros2_deepc.nodes.recorder_node import RecorderNode
from ros2_deepc.ros.lifecycle import ManagedNode
from ros2_deepc.ros.parameters import ConfigError, Param
from ros2_deepc.ros.run import EXECUTORS, Spinner, make_executor, ros
from ros2_deepc.ros.topics import Topic

WORDS = Topic("words", String, "test")
WALK = (
    Transition.TRANSITION_CONFIGURE,
    Transition.TRANSITION_ACTIVATE,
    Transition.TRANSITION_DEACTIVATE,
    Transition.TRANSITION_CLEANUP,
)


class Echo(ManagedNode):
    """Counts what it hears; told "boom", it raises."""

    parameters = (Param("works", True, "whether configure succeeds"),)

    def __init__(self, **kwargs):
        super().__init__("echo", **kwargs)
        self.heard, self.calls = [], []

    def configure(self):
        self.calls.append("configure")
        self.resources.callback(self.calls.append, "released")
        if not self.p["works"]:
            raise ConfigError("echo: set works:=true")
        self.subscribe(WORDS, self._on_word)

    def activate(self):
        self.calls.append("activate")

    def deactivate(self):
        self.calls.append("deactivate")

    def _on_word(self, msg):
        if msg.data == "boom":
            raise KeyError("boom")
        self.heard.append(msg.data)


@pytest.fixture
def rig(domain_id):
    """Makes nodes on one executor and says words to them."""
    with ros([], domain_id) as context:
        executor = make_executor("events", context)
        spinner = Spinner(executor)
        talker = Node("talker", context=context, use_global_arguments=False)
        topic = talker.create_publisher(String, "words", 10)
        witness = []
        talker.create_subscription(String, "words", lambda msg: witness.append(msg.data), 10)
        executor.add_node(talker)
        made = []

        class Rig:
            until = staticmethod(spinner.until)

            def make(self, **parameters):
                overrides = [Parameter(name, value=value) for name, value in parameters.items()]
                made.append(Echo(context=context, parameter_overrides=overrides, use_global_arguments=False))
                executor.add_node(made[-1])
                return made[-1]

            def say(self, word):
                """Says a word and gives everybody the time to hear it."""
                count = len(witness)
                topic.publish(String(data=word))
                spinner.until(lambda: len(witness) > count)
                executor.spin_once(timeout_sec=0.05)

            def connected(self):
                return topic.get_subscription_count() == 2

        yield Rig()
        executor.shutdown()
        for node in (*made, talker):
            node.destroy_node()


def test_callbacks_run_only_while_active(rig):
    echo = rig.make()
    echo.trigger_configure()
    rig.until(rig.connected)
    rig.say("too early")
    echo.trigger_activate()
    rig.say("now")
    rig.until(lambda: echo.heard)
    echo.trigger_deactivate()
    rig.say("too late")
    echo.trigger_activate()
    rig.say("again")
    rig.until(lambda: "again" in echo.heard)
    assert echo.heard == ["now", "again"]
    assert echo.calls == ["configure", "activate", "deactivate", "activate"]


def test_an_exception_in_a_callback_deactivates_and_is_told(rig):
    echo = rig.make()
    echo.start()
    rig.until(rig.connected)
    rig.say("boom")
    rig.until(lambda: echo.fault)
    assert echo.fault == "KeyError: 'boom'"
    assert echo.calls == ["configure", "activate", "deactivate"]


def test_a_failed_configuration_says_why_and_releases_what_it_made(rig):
    echo = rig.make(works=False)
    with pytest.raises(ConfigError, match="set works:=true"):
        echo.start()
    assert echo.calls == ["configure", "released"]


def test_stop_is_idempotent(rig):
    echo = rig.make()
    echo.start()
    echo.stop()
    echo.stop()
    assert echo.calls == ["configure", "activate", "deactivate", "released"]


@pytest.mark.parametrize("executor_name", EXECUTORS)
def test_every_node_walks_through_its_states_by_service_again_and_again(domain_id, executor_name, tmp_path):
    with ros([], domain_id) as context:
        executor = make_executor(executor_name, context)
        spinner = Spinner(executor)
        folder = [Parameter("folder", value=str(tmp_path / "bag"))]
        nodes = [kind(context=context, use_global_arguments=False) for kind in (ControllerNode, MonitorNode, PlantNode)]
        references = [Parameter("reference_values", value=[0.0, 0.0])]
        nodes.append(OperatorNode(context=context, parameter_overrides=references, use_global_arguments=False))
        nodes.append(RecorderNode(context=context, parameter_overrides=folder, use_global_arguments=False))
        caller = Node("caller", context=context, use_global_arguments=False)
        for node in (*nodes, caller):
            executor.add_node(node)
        clients = {
            node.get_name(): caller.create_client(ChangeState, f"{node.get_name()}/change_state") for node in nodes
        }
        for client in clients.values():
            spinner.until(client.service_is_ready)
        for cycle in range(3):
            for transition in WALK:
                for name, client in clients.items():
                    if name == "recorder" and cycle:
                        continue  # its bag exists
                    future = client.call_async(ChangeState.Request(transition=Transition(id=transition)))
                    future.add_done_callback(lambda _: spinner.wake())
                    spinner.until(future.done)
                    assert future.result().success, (name, transition, cycle)
        executor.shutdown()
        for node in (*nodes, caller):
            node.destroy_node()


def test_contexts_come_and_go_without_leaving_threads(domain_id):
    before = threading.active_count()
    for _ in range(10):
        with ros([], domain_id) as context:
            executor = make_executor("events", context)
            node = ControllerNode(context=context, use_global_arguments=False)
            executor.add_node(node)
            node.start()
            executor.spin_once(timeout_sec=0.01)
            node.quiesce()
            executor.shutdown()
            node.stop()
            node.destroy_node()
    assert threading.active_count() == before
