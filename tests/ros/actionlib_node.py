"""A server and a client of ROS' own actionlib, which know nothing of what they are to test.

It offers /tally (actionlib/Test): of a goal it counts up to it, one each 20 ms, and /picky, which rejects each goal. It
sends a goal to /ours as soon as that is there, and says what comes of it.
"""

import json
import sys

import actionlib
import rospy
from actionlib.msg import TestAction, TestFeedback, TestGoal, TestResult


def say(**fact):
    sys.stdout.write(json.dumps(fact) + "\n")
    sys.stdout.flush()


def count(goal):
    for number in range(goal.goal):
        if server.is_preempt_requested():
            server.set_preempted(TestResult(number), "stopped as asked")
            return
        server.publish_feedback(TestFeedback(number))
        rospy.sleep(0.02)
    if goal.goal < 0:
        server.set_aborted(TestResult(-1), "it cannot count down")
    else:
        server.set_succeeded(TestResult(goal.goal), "counted")


rospy.init_node("counter", disable_signals=True)
server = actionlib.SimpleActionServer("tally", TestAction, count, auto_start=False)
server.start()
picky = actionlib.ActionServer("picky", TestAction, lambda handle: handle.set_rejected(text="never"), auto_start=False)
picky.start()
say(ready=True)
client = actionlib.SimpleActionClient("ours", TestAction)
client.wait_for_server()
client.send_goal(TestGoal(5), feedback_cb=lambda told: say(feedback=told.feedback))
client.wait_for_result()
say(state=client.get_state(), result=client.get_result().result, text=client.get_goal_status_text())
client.send_goal(TestGoal(1000))
rospy.sleep(0.5)
client.cancel_goal()
client.wait_for_result()
say(state=client.get_state(), is_cancelled=True)
rospy.spin()
