// A node on rclcpp: `talker RATE SIZE` publishes on `chatter`, a message as content.py makes it.
#include <chrono>
#include <cstdlib>
#include <string>
#include <unistd.h>

#include "rclcpp/rclcpp.hpp"
#include "std_msgs/msg/string.hpp"

using Text = std_msgs::msg::String;

static std::string now()
{
  const auto since = std::chrono::steady_clock::now().time_since_epoch();
  return std::to_string(std::chrono::nanoseconds(since).count());
}

int main(int count, char ** arguments)
{
  const auto given = rclcpp::init_and_remove_ros_arguments(count, arguments);
  const double rate = std::stod(given.at(1));
  const size_t size = std::stoul(given.at(2));
  const auto node = std::make_shared<rclcpp::Node>("talker");
  const auto publisher = node->create_publisher<Text>("chatter", 10);
  const std::string talker = "rclcpp-" + std::to_string(getpid()) + "-" + now();
  size_t number = 0;
  const auto timer = node->create_wall_timer(
    std::chrono::nanoseconds(static_cast<long long>(1e9 / rate)), [&]() {
      Text message;
      message.data = talker + " " + std::to_string(++number) + " " + now() + " ";
      message.data.resize(std::max(size, message.data.size()), 'x');
      publisher->publish(message);
    });
  rclcpp::spin(node);
  rclcpp::shutdown();
}
