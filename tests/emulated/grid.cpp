// The device: runs the blocks of a launch on two threads of the system, in an order that no kernel may rely on.
//
// Blocks come in a scrambled order, the warps of a block too, and the lanes of a warp between any two collectives. A
// thread runs until it ends or waits for others; what spins until another thread of its block writes something never ends.
#include "processor.h"

#include <thread>

static constexpr int NUM_SYSTEM_THREADS = 2;

thread_local dim3 blockIdx { 0, 0, 0 }, threadIdx { 0, 0, 0 }, blockDim { 1, 1, 1 }, gridDim { 1, 1, 1 };

const uint64_t* exchange(const char* name, unsigned mask, uint64_t value)
{
    return Processor::current().exchange(name, mask, value);
}

void wait_for_block(const char* name) { Processor::current().wait(name, 0); }

void fail_launch(const char* format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    Failure::record(format, arguments);
    va_end(arguments);
    throw ThreadEnded();
}

// Processors stay for the next launch, with their stacks.
class Processors {
public:
    std::unique_ptr<Processor> take()
    {
        std::lock_guard<std::mutex> guard(lock_);
        if (unused_.empty())
            return std::make_unique<Processor>(++num_made_);
        std::unique_ptr<Processor> processor = std::move(unused_.back());
        unused_.pop_back();
        return processor;
    }
    void put_back(std::unique_ptr<Processor> processor)
    {
        std::lock_guard<std::mutex> guard(lock_);
        unused_.push_back(std::move(processor));
    }

private:
    std::mutex lock_;
    std::vector<std::unique_ptr<Processor>> unused_;
    uint64_t num_made_ = 0;
};

int run_grid(size_t size, unsigned block_size, int is_cooperative, DeviceFunction function, void* argument)
{
    static Processors processors;
    static std::atomic<uint64_t> num_launches { 0 };
    Scrambler scrambler(++num_launches);
    const Launch launch { function, argument, is_cooperative != 0 };
    const size_t num_blocks = size ? (size + block_size - 1) / block_size : 1;
    const ScrambledRange order(num_blocks, scrambler);
    std::atomic<size_t> next { 0 };
    const auto work = [&] {
        std::unique_ptr<Processor> processor = processors.take();
        blockDim = { block_size, 1, 1 };
        gridDim = { (unsigned)num_blocks, 1, 1 };
        for (size_t k; (k = next.fetch_add(1)) < num_blocks && !Failure::is_set();)
            processor->run_block({ (unsigned)order[k], 0, 0 }, block_size, launch);
        processors.put_back(std::move(processor));
    };
    std::vector<std::thread> others;
    for (int k = 1; k < NUM_SYSTEM_THREADS && (size_t)k < num_blocks; ++k)
        others.emplace_back(work);
    work();
    for (std::thread& other : others)
        other.join();
    return Failure::is_set();
}

const char* take_error()
{
    static thread_local std::string taken;
    taken = Failure::take();
    return taken.c_str();
}
