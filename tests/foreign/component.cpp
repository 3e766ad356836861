// A library of composable nodes on rclcpp: `demo::Talker` publishes "INSTANCE-TEXT NUMBER" on `chatter`, 50 times a second.
// `demo::Listener` says on `heard`, in the same way, whom it has heard last on `chatter`. Both ask for intra-process
// communication. TEXT is set when it is linked.
#include <chrono>
#include <cstdlib>
#include <memory>
#include <string>
#include <utility>

#include "rclcpp/rclcpp.hpp"
#include "rclcpp_components/register_node_macro.hpp"
#include "std_msgs/msg/string.hpp"

extern "C" const char demo_text[];

namespace demo
{
using Text = std_msgs::msg::String;

class Talker : public rclcpp::Node
{
public:
  explicit Talker(const rclcpp::NodeOptions & options)
  : Node("talker", rclcpp::NodeOptions(options).use_intra_process_comms(true))
  {
    publisher_ = create_publisher<Text>("chatter", 1000);  // a listener may be late
    timer_ = create_wall_timer(std::chrono::milliseconds(20), [this] {
        auto message = std::make_unique<Text>();
        message->data = writer() + " " + std::to_string(++number_);
        publisher_->publish(std::move(message));
      });
  }

private:
  static std::string writer()
  {
    const char * instance = std::getenv("MIDSTRIDE_INSTANCE");
    return std::string(instance ? instance : "none") + "-" + demo_text;
  }

  rclcpp::Publisher<Text>::SharedPtr publisher_;
  rclcpp::TimerBase::SharedPtr timer_;
  uint64_t number_ = 0;
};

class Listener : public rclcpp::Node
{
public:
  explicit Listener(const rclcpp::NodeOptions & options)
  : Node("listener", rclcpp::NodeOptions(options).use_intra_process_comms(true))
  {
    publisher_ = create_publisher<Text>("heard", 1000);
    subscription_ = create_subscription<Text>("chatter", 1000, [this](Text::UniquePtr message) {
        publisher_->publish(std::move(message));
      });
  }

private:
  rclcpp::Publisher<Text>::SharedPtr publisher_;
  rclcpp::Subscription<Text>::SharedPtr subscription_;
};
}  // namespace demo

RCLCPP_COMPONENTS_REGISTER_NODE(demo::Talker)
RCLCPP_COMPONENTS_REGISTER_NODE(demo::Listener)
