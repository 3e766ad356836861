/* A member function of rclcpp, by its name in the library: PublisherBase::setup_intra_process, which a publisher has called
 * once it is registered with the manager of intra-process communication. From Lyrical on, the manager is passed otherwise. */
#ifdef LYRICAL
#define SETUP "_ZN6rclcpp13PublisherBase19setup_intra_processEmRKSt10shared_ptrINS_12experimental19IntraProcessManagerEE"
#else
#define SETUP "_ZN6rclcpp13PublisherBase19setup_intra_processEmSt10shared_ptrINS_12experimental19IntraProcessManagerEE"
#endif
