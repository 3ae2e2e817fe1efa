// A participant of Fast DDS, the middleware that ROS 2 Humble comes with, for the tests: it knows no messages, and has
// endpoints made, samples written and samples told as its standard input and output say, line by line.
//
// Argument: the domain. It joins on loopback alone, with the transports, QoS and user data of rmw_fastrtps.
//
//   make w|r ID TOPIC TYPE reliable|best_effort|transient_local    ->  made ID GUID
//   write ID CDR [GUID NUMBER]      with the related sample identity: the client of a reply, and which request of its
//   drop ID
//   matched ID COUNT, sample ID WRITER NUMBER CLIENT REQUEST CDR   as they happen; bytes are hexadecimal

#include <cstring>
#include <functional>
#include <iostream>
#include <map>
#include <memory>
#include <mutex>
#include <sstream>
#include <string>
#include <vector>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/DataWriterListener.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <fastdds/rtps/common/WriteParams.h>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>

using namespace eprosima::fastdds::dds;
using eprosima::fastdds::rtps::UDPv4TransportDescriptor;
using eprosima::fastrtps::rtps::GUID_t;
using eprosima::fastrtps::rtps::InstanceHandle_t;
using eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
using eprosima::fastrtps::rtps::SerializedPayload_t;
using eprosima::fastrtps::rtps::WriteParams;

using Bytes = std::vector<unsigned char>;

namespace {

std::mutex said;

void say(const std::string& line) {
    std::lock_guard<std::mutex> lock(said);
    std::cout << line << std::endl;
}

std::string hex(const unsigned char* bytes, size_t count) {
    static const char digits[] = "0123456789abcdef";
    std::string text(2 * count, '0');
    for (size_t i = 0; i < count; ++i) {
        text[2 * i] = digits[bytes[i] >> 4];
        text[2 * i + 1] = digits[bytes[i] & 15];
    }
    return text;
}

std::string hex(const GUID_t& guid) {
    return hex(guid.guidPrefix.value, 12) + hex(guid.entityId.value, 4);
}

Bytes bytes_of(const std::string& text) {
    auto digit = [](char c) { return c <= '9' ? c - '0' : c - 'a' + 10; };
    Bytes bytes(text.size() / 2);
    for (size_t i = 0; i < bytes.size(); ++i) bytes[i] = digit(text[2 * i]) * 16 + digit(text[2 * i + 1]);
    return bytes;
}

// A type that is a name; its samples are the CDR that they are on the wire, with its header.
class RawType : public TopicDataType {
public:
    explicit RawType(const std::string& name) {
        setName(name.c_str());
        m_typeSize = 4096;  // where larger ones come, memory is got anew
        m_isGetKeyDefined = false;
        auto_fill_type_object(false);
        auto_fill_type_information(false);
    }
    bool serialize(void* data, SerializedPayload_t* payload) override {
        const Bytes& bytes = *static_cast<Bytes*>(data);
        payload->encapsulation = CDR_LE;
        payload->length = static_cast<uint32_t>(bytes.size());
        std::memcpy(payload->data, bytes.data(), bytes.size());
        return true;
    }
    bool deserialize(SerializedPayload_t* payload, void* data) override {
        static_cast<Bytes*>(data)->assign(payload->data, payload->data + payload->length);
        return true;
    }
    std::function<uint32_t()> getSerializedSizeProvider(void* data) override {
        return [data] { return static_cast<uint32_t>(static_cast<Bytes*>(data)->size()); };
    }
    void* createData() override { return new Bytes; }
    void deleteData(void* data) override { delete static_cast<Bytes*>(data); }
    bool getKey(void*, InstanceHandle_t*, bool) override { return false; }
};

template <class Qos>
void set_policies(Qos& qos, const std::string& profile) {
    bool is_kept = profile == "transient_local", is_reliable = is_kept || profile == "reliable";
    qos.reliability().kind = is_reliable ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
    qos.durability().kind = is_kept ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
    qos.history().kind = KEEP_LAST_HISTORY_QOS;
    qos.history().depth = is_kept ? 1 : 10;  // rmw/qos_profiles.h: default, services
    qos.endpoint().history_memory_policy = PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    qos.data_sharing().off();
}

struct Hearing : DataReaderListener {
    std::string id;
    void on_data_available(DataReader* reader) override {
        Bytes bytes;
        SampleInfo info;
        while (reader->take_next_sample(&bytes, &info) == ReturnCode_t::RETCODE_OK) {
            if (!info.valid_data) continue;
            auto number = [](const auto& identity) { return std::to_string(identity.sequence_number().to64long()); };
            say("sample " + id + " " + hex(info.sample_identity.writer_guid()) + " " + number(info.sample_identity) +
                " " + hex(info.related_sample_identity.writer_guid()) + " " + number(info.related_sample_identity) +
                " " + hex(bytes.data(), bytes.size()));
        }
    }
    void on_subscription_matched(DataReader*, const SubscriptionMatchedStatus& status) override {
        say("matched " + id + " " + std::to_string(status.current_count));
    }
};

struct Writing : DataWriterListener {
    std::string id;
    void on_publication_matched(DataWriter*, const PublicationMatchedStatus& status) override {
        say("matched " + id + " " + std::to_string(status.current_count));
    }
};

struct Relay {
    DomainParticipant* participant = nullptr;
    Publisher* publisher = nullptr;
    Subscriber* subscriber = nullptr;
    std::map<std::string, DataWriter*> writers;
    std::map<std::string, DataReader*> readers;
    std::vector<std::unique_ptr<DataReaderListener>> hearings;
    std::vector<std::unique_ptr<DataWriterListener>> writings;

    explicit Relay(int domain) {
        DomainParticipantQos qos;
        const std::string enclave = "enclave=/;";
        qos.user_data().setValue({enclave.begin(), enclave.end()});
        qos.name("/");
        // As rmw_fastrtps does for ROS_LOCALHOST_ONLY=1.
        auto udp = std::make_shared<UDPv4TransportDescriptor>();
        udp->interfaceWhiteList.emplace_back("127.0.0.1");
        qos.transport().use_builtin_transports = false;
        qos.transport().user_transports.push_back(udp);
        participant = DomainParticipantFactory::get_instance()->create_participant(domain, qos);
        if (participant == nullptr) throw std::runtime_error("the domain cannot be joined");
        publisher = participant->create_publisher(PUBLISHER_QOS_DEFAULT);
        subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
    }

    ~Relay() {
        participant->delete_contained_entities();
        DomainParticipantFactory::get_instance()->delete_participant(participant);
    }

    Topic* topic(const std::string& name, const std::string& type) {
        if (auto* known = dynamic_cast<Topic*>(participant->lookup_topicdescription(name))) return known;
        TypeSupport(new RawType(type)).register_type(participant);
        return participant->create_topic(name, type, TOPIC_QOS_DEFAULT);
    }

    void make(std::istream& words) {
        std::string kind, id, name, type, profile;
        words >> kind >> id >> name >> type >> profile;
        GUID_t guid;
        if (kind == "w") {
            auto listener = std::make_unique<Writing>();
            listener->id = id;
            DataWriterQos qos;
            set_policies(qos, profile);
            writers[id] = publisher->create_datawriter(topic(name, type), qos, listener.get());
            writings.push_back(std::move(listener));
            guid = writers[id]->guid();
        } else {
            auto listener = std::make_unique<Hearing>();
            listener->id = id;
            DataReaderQos qos;
            set_policies(qos, profile);
            readers[id] = subscriber->create_datareader(topic(name, type), qos, listener.get());
            hearings.push_back(std::move(listener));
            guid = readers[id]->guid();
        }
        say("made " + id + " " + hex(guid));
    }

    void write(std::istream& words) {
        std::string id, data, client;
        long long number = 0;
        words >> id >> data;
        Bytes bytes = bytes_of(data);
        WriteParams params;
        if (words >> client >> number) {
            Bytes guid = bytes_of(client);
            auto& related = params.related_sample_identity();
            std::memcpy(related.writer_guid().guidPrefix.value, guid.data(), 12);
            std::memcpy(related.writer_guid().entityId.value, guid.data() + 12, 4);
            related.sequence_number().high = static_cast<int32_t>(number >> 32);
            related.sequence_number().low = static_cast<uint32_t>(number);
        }
        if (!writers.at(id)->write(&bytes, params)) say("unwritten " + id);
    }

    void drop(const std::string& id) {
        if (writers.count(id)) publisher->delete_datawriter(writers[id]), writers.erase(id);
        if (readers.count(id)) subscriber->delete_datareader(readers[id]), readers.erase(id);
    }
};

}  // namespace

int main(int, char** arguments) {
    std::ios::sync_with_stdio(false);
    Relay relay(std::stoi(arguments[1]));
    say("ready " + hex(relay.participant->guid()));
    std::string line, verb, id;
    while (std::getline(std::cin, line)) {
        std::istringstream words(line);
        words >> verb;
        if (verb == "make") relay.make(words);
        if (verb == "write") relay.write(words);
        if (verb == "drop" && words >> id) relay.drop(id);
    }
}
